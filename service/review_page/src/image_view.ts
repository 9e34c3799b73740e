// The camera's image with all boxes; rejected hypotheses of the selected object are dashed.
import { EDGES, FRONT_CROSS, colorOf, corners, project } from "./geometry";
import type { Review } from "./review";
import type { Box, DetectedObject } from "./types";

export class ImageView {
  private scale = 1;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly review: Review,
  ) {
    canvas.addEventListener("click", (event) => this.pick(event));
  }

  draw(): void {
    const frame = this.review.frame;
    const [width, height] = frame?.answer.image_size ?? [1242, 375];
    const shown = this.canvas.parentElement!;
    const ratio = window.devicePixelRatio || 1;
    this.scale = Math.min(shown.clientWidth / width, (0.45 * window.innerHeight) / height);
    this.canvas.width = Math.max(1, Math.round(width * this.scale * ratio));
    this.canvas.height = Math.max(1, Math.round(height * this.scale * ratio));
    this.canvas.style.width = `${width * this.scale}px`;
    const context = this.canvas.getContext("2d")!;
    context.scale(this.scale * ratio, this.scale * ratio);
    context.fillStyle = "#121418";
    context.fillRect(0, 0, width, height);
    if (frame?.image) context.drawImage(frame.image, 0, 0, width, height);
    for (const item of this.review.objects) if (item.index !== this.review.selected) this.object(context, item);
    const selected = this.review.object;
    if (!selected) return;
    selected.rejected.forEach((each, at) =>
      this.wireframe(context, each.box, colorOf(selected.index), 1, at === this.review.hypothesis ? 0.9 : 0.35, true),
    );
    this.object(context, selected);
  }

  private object(context: CanvasRenderingContext2D, item: DetectedObject): void {
    const selected = item.index === this.review.selected;
    const verdict = this.review.opinionOf(item.index).verdict;
    const [x1, y1, x2, y2] = item.prompt_box_px;
    const color = colorOf(item.index);
    context.strokeStyle = color;
    context.lineWidth = (selected ? 1.5 : 0.7) / this.scale;
    context.globalAlpha = selected ? 0.8 : 0.4;
    context.strokeRect(x1, y1, x2 - x1, y2 - y1);
    context.globalAlpha = 1;
    const box = this.review.boxOf(item);
    if (box) this.wireframe(context, box, color, selected ? 2.5 : 1.2, verdict === "rejected" ? 0.25 : 1);
    context.font = `${13 / this.scale}px system-ui, sans-serif`;
    const text = `${item.index}${verdict === "accepted" ? " ✓" : verdict === "rejected" ? " ✗" : verdict === "corrected" ? " ✎" : ""}`;
    context.lineWidth = 3 / this.scale;
    context.strokeStyle = "#121418";
    context.strokeText(text, x1, Math.max(12 / this.scale, y1 - 3 / this.scale));
    context.fillStyle = color;
    context.fillText(text, x1, Math.max(12 / this.scale, y1 - 3 / this.scale));
  }

  private wireframe(
    context: CanvasRenderingContext2D, box: Box, color: string, width: number, alpha: number, dashed = false,
  ): void {
    const P = this.review.frame?.answer.image_P_cam;
    if (!P) return;
    const ends = corners(box).map((corner) => project(P, corner));
    context.strokeStyle = color;
    context.globalAlpha = alpha;
    context.setLineDash(dashed ? [6 / this.scale, 4 / this.scale] : []);
    for (const [lines, thickness] of [[EDGES, width], [FRONT_CROSS, width / 2]] as const) {
      context.lineWidth = thickness / this.scale;
      context.beginPath();
      for (const [a, b] of lines) {
        const [from, to] = [ends[a], ends[b]];
        if (!from || !to) continue;
        context.moveTo(...from);
        context.lineTo(...to);
      }
      context.stroke();
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  /** The smallest prompt under the pointer. */
  private pick(event: MouseEvent): void {
    const rectangle = this.canvas.getBoundingClientRect();
    const x = (event.clientX - rectangle.left) / this.scale;
    const y = (event.clientY - rectangle.top) / this.scale;
    const hit = this.review.objects
      .filter(({ prompt_box_px: [x1, y1, x2, y2] }) => x >= x1 && x <= x2 && y >= y1 && y <= y2)
      .sort((a, b) => area(a) - area(b))[0];
    if (hit) this.review.select(hit.index);
  }
}

function area({ prompt_box_px: [x1, y1, x2, y2] }: DetectedObject): number {
  return (x2 - x1) * (y2 - y1);
}
