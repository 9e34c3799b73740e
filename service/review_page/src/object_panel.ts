// All that is known of the selected object, in words and numbers.
import type { Review } from "./review";
import type { Box } from "./types";

export class ObjectPanel {
  constructor(
    private readonly title: HTMLElement,
    private readonly facts: HTMLElement,
    private readonly classSelect: HTMLSelectElement,
    private readonly review: Review,
    private readonly classes: () => string[],
  ) {
    classSelect.addEventListener("change", () => {
      this.review.edit((box) => box, this.classSelect.value);
    });
  }

  draw(): void {
    const item = this.review.object;
    this.classSelect.disabled = !item || !this.review.boxOf(item);
    if (!item) {
      this.title.textContent = "No object selected";
      this.facts.replaceChildren();
      return;
    }
    const category = this.review.classOf(item);
    const names = [...new Set([...this.classes(), item.class, category])].sort();
    this.classSelect.replaceChildren(...names.map((name) => new Option(name, name, false, name === category)));
    this.title.textContent = `Object ${item.index} of ${this.review.frame?.name}`;
    const opinion = this.review.opinionOf(item.index);
    const said = this.review.correctionOf(this.review.frame?.name ?? "", item.index);
    const by = said && opinion.verdict !== "open" ? ` by ${said.author}, ${new Date(said.made_at).toLocaleString()}` : "";
    const rows: [string, string][] = [
      ["Verdict", opinion.verdict + by],
      ["Result", item.sentence],
      ["Score", item.score.toFixed(2) + (item.iou_probability ? ` (IoU > .7: ${item.iou_probability[1].toFixed(2)})` : "")],
      ["Flags", item.flags.map((flag) => flag.replaceAll("_", " ")).join(", ") || "none"],
      ["Points", `${item.points.in_prompt} in the 2D box, ${item.points.used} used`],
    ];
    if (item.losses)
      rows.push([
        "Losses",
        `geometric ${item.losses.geometric.toFixed(3)}, ray ${item.losses.ray_tracing.toFixed(3)}, ` +
          `centre ${item.losses.center.toFixed(3)} m`,
      ]);
    if (item.track) rows.push(["Track", `${item.track.id}, ${item.track.motion}, ${item.track.sightings} sightings`]);
    const box = this.review.boxOf(item);
    if (box) rows.push(["Box", inWords(box)]);
    item.rejected.forEach((each, at) => {
      const mark = at === this.review.hypothesis ? "▸ " : "";
      rows.push([`Rejected ${at + 1}`, `${mark}${each.reason}`]);
    });
    this.facts.replaceChildren(
      ...rows.flatMap(([name, value]) => [element("dt", name), element("dd", value)]),
    );
  }
}

function inWords(box: Box): string {
  const [x, y, z] = box.center_cam.map((each) => each.toFixed(2));
  const size = [box.length_m, box.width_m, box.height_m].map((each) => each.toFixed(2)).join(" × ");
  return `at ${x}, ${y}, ${z} m; ${size} m; ${((180 / Math.PI) * box.rotation_y).toFixed(1)}°`;
}

export function element(name: string, text: string): HTMLElement {
  const made = document.createElement(name);
  made.textContent = text;
  return made;
}
