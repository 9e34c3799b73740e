// The queue as a list: what is worth most first, and who looks at what.
import type { Review } from "./review";

const SHOWN = 200;

export class QueueList {
  private shownFor = "";

  constructor(
    private readonly list: HTMLElement,
    private readonly progress: HTMLElement,
    private readonly review: Review,
    private readonly open: (frame: string, index: number) => Promise<void>,
  ) {
    list.addEventListener("click", (event) => {
      const row = (event.target as HTMLElement).closest<HTMLElement>("[role=option]");
      if (row) void this.open(row.dataset["frame"]!, Number(row.dataset["index"]));
    });
    list.addEventListener("keydown", (event) => this.move(event));
  }

  draw(): void {
    const queue = this.review.queue;
    this.progress.textContent = queue
      ? `${queue.objects} objects, ${this.review.reviewed} reviewed` +
        (queue.frames_read < queue.frames ? `; ${queue.frames_read} of ${queue.frames} frames read` : "")
      : "";
    const taken = new Map(this.review.others.map((each) => [each.frame, each.author]));
    const rows = (queue?.entries ?? []).slice(0, SHOWN).map((entry) => {
      const verdict =
        entry.frame === this.review.frame?.name
          ? this.review.opinionOf(entry.index).verdict
          : (this.review.correctionOf(entry.frame, entry.index)?.opinion.verdict ?? "open");
      const other = taken.get(entry.frame);
      const mark = { open: "", accepted: "✓", corrected: "✎", rejected: "✗" }[verdict];
      const value = entry.has_box ? entry.score.toFixed(2) : "no box";
      return { entry, verdict, text: `${entry.category} ${value} ${mark}`, place: `${entry.frame} #${entry.index}`, other };
    });
    const at = `${this.review.frame?.name}/${this.review.selected}`;
    const state = JSON.stringify([rows.map((row) => [row.place, row.text, row.other]), at]);
    if (state === this.shownFor) return;
    this.shownFor = state;
    this.list.replaceChildren(
      ...rows.map(({ entry, verdict, text, place, other }, row) => {
        const option = document.createElement("div");
        option.setAttribute("role", "option");
        option.id = `queue-${row}`;
        option.dataset["frame"] = entry.frame;
        option.dataset["index"] = String(entry.index);
        option.dataset["verdict"] = verdict;
        const here = `${entry.frame}/${entry.index}` === at;
        option.setAttribute("aria-selected", String(here));
        option.append(span(text, "what"), span(other ? `${place} · ${other} is here` : place, "where"));
        return option;
      }),
    );
    const selected = this.list.querySelector("[aria-selected=true]");
    if (selected) {
      this.list.setAttribute("aria-activedescendant", selected.id);
      selected.scrollIntoView({ block: "nearest" });
    } else this.list.removeAttribute("aria-activedescendant");
  }

  private move(event: KeyboardEvent): void {
    const step = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
    if (!step) return;
    event.preventDefault();
    const rows = [...this.list.querySelectorAll<HTMLElement>("[role=option]")];
    const here = rows.findIndex((row) => row.getAttribute("aria-selected") === "true");
    const next = rows[Math.min(Math.max(here + step, 0), rows.length - 1)];
    if (next) void this.open(next.dataset["frame"]!, Number(next.dataset["index"]));
  }
}

function span(text: string, name: string): HTMLElement {
  const made = document.createElement("span");
  made.className = name;
  made.textContent = text;
  return made;
}
