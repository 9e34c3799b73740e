// What is open and selected, what was said about it, and how that gets to the service and back.
import { Problem, getJson, postJson, request } from "./api";
import type { Box, Correction, DetectedObject, FrameAnswer, Opinion, Queue, QueueEntry } from "./types";

export interface OpenFrame {
  name: string;
  answer: FrameAnswer;
  points: Float32Array;
  image: ImageBitmap | null;
}

const OPEN: Opinion = { verdict: "open", box: null, category: null };
const SAVE_AFTER_MS = 500;

/** One person's review of one label set. Listeners are called after every change. */
export class Review {
  labelSet = "";
  author = "";
  queue: Queue | null = null;
  frame: OpenFrame | null = null;
  selected = -1;
  /** A rejected hypothesis of the selected object that is looked at; -1: none. */
  hypothesis = -1;
  status = "";
  failing = false;
  others: { frame: string; author: string }[] = [];
  readonly session = crypto.randomUUID();

  private readonly said = new Map<string, Correction>();
  private readonly drafts = new Map<string, Opinion>();
  private readonly undoable = new Map<string, Opinion[]>();
  private readonly waiting = new Map<string, number>();
  private saving: Promise<void> = Promise.resolve();
  private unsaved = 0;
  private sequence = 0;
  private opening = 0;

  constructor(private readonly changed: () => void) {}

  get objects(): DetectedObject[] {
    return this.frame?.answer.details.objects ?? [];
  }

  get object(): DetectedObject | null {
    return this.objects.find((each) => each.index === this.selected) ?? null;
  }

  get isSaved(): boolean {
    return this.unsaved === 0 && this.waiting.size === 0;
  }

  /** What is thought of an object now: not yet saved edits go first. */
  opinionOf(index: number): Opinion {
    const key = this.key(index);
    return this.drafts.get(key) ?? this.said.get(key)?.opinion ?? OPEN;
  }

  /** Objects of which somebody said something that still holds. */
  get reviewed(): number {
    const spoken = [...this.said.values()].filter((each) => each.opinion.verdict !== "open");
    return spoken.length;
  }

  correctionOf(frame: string, index: number): Correction | null {
    return this.said.get(`${frame}/${index}`) ?? null;
  }

  boxOf(item: DetectedObject): Box | null {
    return this.opinionOf(item.index).box ?? item.box;
  }

  classOf(item: DetectedObject): string {
    return this.opinionOf(item.index).category ?? item.class;
  }

  async openSet(name: string): Promise<void> {
    await this.flush();
    this.labelSet = name;
    this.frame = null;
    this.selected = -1;
    this.sequence = 0;
    this.said.clear();
    this.drafts.clear();
    this.undoable.clear();
    await this.refreshQueue();
    await this.heartbeat();
  }

  async refreshQueue(): Promise<void> {
    this.queue = await getJson<Queue>("/review/queue", { set: this.labelSet });
    this.changed();
  }

  async openFrame(name: string, index: number): Promise<void> {
    this.flushWaiting();
    this.hypothesis = -1;
    if (this.frame?.name === name) {
      this.selected = index;
      this.changed();
      return;
    }
    const turn = ++this.opening;
    const query = { set: this.labelSet, frame: name };
    const search = new URLSearchParams(query).toString();
    const answer = await getJson<FrameAnswer>("/review/frame", query);
    const [points, image] = await Promise.all([
      answer.points ? request(`/review/points?${search}`).then((r) => r.arrayBuffer()) : new ArrayBuffer(0),
      answer.has_image ? request(`/review/image?${search}`).then((r) => r.blob()) : null,
    ]);
    const bitmap = image ? await createImageBitmap(image) : null;
    if (turn !== this.opening) return; // another frame was opened meanwhile
    this.take(answer.corrections);
    this.frame = { name, answer, points: new Float32Array(points), image: bitmap };
    this.selected = index >= 0 ? index : (answer.details.objects[0]?.index ?? -1);
    this.changed();
    await this.heartbeat();
  }

  select(index: number): void {
    this.flushWaiting();
    this.selected = index;
    this.hypothesis = -1;
    this.changed();
  }

  /** The next object that is worth a look, of frames where nobody else is; or the one before. */
  nextEntry(step: 1 | -1): QueueEntry | null {
    const entries = this.queue?.entries ?? [];
    const here = entries.findIndex((each) => each.frame === this.frame?.name && each.index === this.selected);
    if (step < 0) return entries[here - 1] ?? null;
    return entries.slice(here + 1).find((each) => this.isOpenToMe(each)) ?? null;
  }

  /** The first of the queue. */
  firstEntry(): QueueEntry | null {
    return this.queue?.entries.find((each) => this.isOpenToMe(each)) ?? null;
  }

  private isOpenToMe({ frame, index }: QueueEntry): boolean {
    const verdict = this.said.get(`${frame}/${index}`)?.opinion.verdict ?? "open";
    const isTaken = frame !== this.frame?.name && this.others.some((each) => each.frame === frame);
    return verdict === "open" && !isTaken;
  }

  /** Say something about the selected object; edits that follow each other closely are saved as one. */
  say(opinion: Opinion, { soon = false } = {}): void {
    const key = this.key(this.selected);
    const before = this.opinionOf(this.selected);
    if (!soon || !this.waiting.has(key)) {
      const stack = this.undoable.get(key) ?? [];
      this.undoable.set(key, [...stack, before]);
    }
    this.keep(key, opinion, soon ? SAVE_AFTER_MS : 0);
  }

  /** Edit the box or the class of the selected object. */
  edit(change: (box: Box) => Box, category?: string): void {
    const item = this.object;
    const box = item && this.boxOf(item);
    if (!item || !box) return;
    const next = change(box);
    this.say({ verdict: "corrected", box: next, category: category ?? this.classOf(item) }, { soon: true });
  }

  undo(): boolean {
    const key = this.key(this.selected);
    const stack = this.undoable.get(key) ?? [];
    // After a reload, what can be taken back is what was said last.
    const before = stack.length ? stack[stack.length - 1]! : OPEN;
    if (!stack.length && this.opinionOf(this.selected).verdict === "open") return false;
    this.undoable.set(key, stack.slice(0, -1));
    this.keep(key, before, 0);
    return true;
  }

  /** All that waits is sent now; resolves when the service has confirmed it. */
  async flush(): Promise<void> {
    this.flushWaiting();
    await this.saving;
  }

  async heartbeat(): Promise<void> {
    if (!this.labelSet) return;
    const answer = await postJson<{ others: Review["others"]; corrections: Correction[] }>("/review/heartbeat", {
      label_set: this.labelSet,
      frame: this.frame?.name ?? "",
      session: this.session,
      author: this.author,
      since: this.sequence,
    });
    this.others = answer.others;
    this.take(answer.corrections);
    for (const each of answer.corrections) this.sequence = Math.max(this.sequence, each.sequence);
    this.changed();
  }

  private key(index: number): string {
    return `${this.frame?.name ?? ""}/${index}`;
  }

  private take(corrections: Correction[]): void {
    for (const each of corrections) {
      const key = `${each.frame}/${each.object_index}`;
      if ((this.said.get(key)?.revision ?? 0) < each.revision) this.said.set(key, each);
    }
  }

  private keep(key: string, opinion: Opinion, afterMs: number): void {
    this.drafts.set(key, opinion);
    this.status = "Saving …";
    window.clearTimeout(this.waiting.get(key));
    if (afterMs) this.waiting.set(key, window.setTimeout(() => this.save(key), afterMs));
    else this.save(key);
    this.changed();
  }

  private flushWaiting(): void {
    for (const [key, timer] of [...this.waiting]) {
      window.clearTimeout(timer);
      this.save(key);
    }
  }

  private save(key: string): void {
    this.waiting.delete(key);
    const opinion = this.drafts.get(key);
    if (!opinion) return;
    const at = key.lastIndexOf("/");
    const [labelSet, frame, index] = [this.labelSet, key.slice(0, at), Number(key.slice(at + 1))];
    const id = crypto.randomUUID();
    this.unsaved += 1;
    this.saving = this.saving.then(() => this.send(labelSet, key, frame, index, opinion, id));
  }

  /** Sent again under the same id until the service answers: an answer may have been lost. */
  private async send(
    labelSet: string, key: string, frame: string, index: number, opinion: Opinion, id: string,
  ): Promise<void> {
    for (let pause = 500; ; pause = Math.min(2 * pause, 8000)) {
      try {
        const kept = await postJson<Correction>("/review/corrections", {
          label_set: labelSet,
          frame,
          object_index: index,
          based_on: this.said.get(key)?.revision ?? 0,
          opinion,
          author: this.author,
          request_id: id,
        });
        this.take([kept]);
        this.status = `Saved at ${new Date(kept.made_at).toLocaleTimeString()}`;
        this.failing = false;
        break;
      } catch (error) {
        if (error instanceof Problem && error.status === 409) {
          const latest = error.body["latest"] as Correction | null;
          if (latest) this.take([latest]);
          this.status = `Not saved: ${error.message} Theirs is shown.`;
          this.undoable.delete(key);
          this.failing = true;
          break;
        }
        if (error instanceof Problem && error.status < 500 && error.status !== 429 && error.status !== 408) {
          this.status = `Not saved: ${error.message}`;
          this.failing = true;
          break;
        }
        this.status = "Not saved yet: the service does not answer. Trying again …";
        this.failing = true;
        this.changed();
        await new Promise((resolve) => window.setTimeout(resolve, pause));
      }
    }
    this.unsaved -= 1;
    if (this.drafts.get(key) === opinion) this.drafts.delete(key);
    this.changed();
  }
}
