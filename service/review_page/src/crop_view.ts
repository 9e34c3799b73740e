// The selected box and the points around it, cut out in its own frame: from its side, its front, from above.
import { colorOf, toBox } from "./geometry";
import type { OpenFrame, Review } from "./review";
import type { Box } from "./types";

const MARGIN_M = 1.0;

export class CropView {
  constructor(
    private readonly canvases: { side: HTMLCanvasElement; front: HTMLCanvasElement; top: HTMLCanvasElement },
    private readonly review: Review,
  ) {}

  draw(): void {
    const item = this.review.object;
    const box = item && (item.rejected[this.review.hypothesis]?.box ?? this.review.boxOf(item));
    const frame = this.review.frame;
    const color = item ? colorOf(item.index) : "#888";
    const near = box && frame ? pointsNear(frame, box) : [];
    for (const [canvas, axes] of [
      [this.canvases.side, [0, 1]],
      [this.canvases.front, [2, 1]],
      [this.canvases.top, [0, 2]],
    ] as const)
      drawCrop(canvas, box, near, axes, color);
  }
}

function pointsNear(frame: OpenFrame, box: Box): [number, number, number][] {
  const reach = Math.hypot(box.length_m, box.width_m) / 2 + MARGIN_M;
  const [cx, cy, cz] = box.center_cam;
  const found: [number, number, number][] = [];
  const points = frame.points;
  for (let at = 0; at < points.length; at += 3) {
    const [x, y, z] = [points[at]!, points[at + 1]!, points[at + 2]!];
    if (Math.abs(x - cx) < reach && Math.abs(z - cz) < reach && Math.abs(y - cy) < box.height_m / 2 + MARGIN_M) {
      const inside = toBox(box, x, y, z);
      if (Math.abs(inside[0]) < box.length_m / 2 + MARGIN_M && Math.abs(inside[2]) < box.width_m / 2 + MARGIN_M)
        found.push(inside);
    }
  }
  return found;
}

function drawCrop(
  canvas: HTMLCanvasElement,
  box: Box | null,
  near: [number, number, number][],
  [across, down]: readonly [0 | 2, 1 | 2],
  color: string,
): void {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d")!;
  context.scale(ratio, ratio);
  context.fillStyle = "#121418";
  context.fillRect(0, 0, width, height);
  if (!box) return;
  const sizes = [box.length_m, box.height_m, box.width_m];
  const [w, h] = [sizes[across]!, sizes[down]!];
  const scale = Math.min(width / (w + 2 * MARGIN_M), height / (h + 2 * MARGIN_M));
  context.translate(width / 2, height / 2);
  // From above the front is right and the left side up; from the side the front is right.
  const flip = down === 2 ? -1 : 1;
  context.fillStyle = "#b9c0cc";
  for (const point of near) context.fillRect(point[across] * scale - 0.8, flip * point[down] * scale - 0.8, 1.6, 1.6);
  context.strokeStyle = color;
  context.lineWidth = 1.5;
  context.strokeRect((-w / 2) * scale, (-h / 2) * scale, w * scale, h * scale);
  if (across === 0) {
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(0.65 * w * scale, 0);
    context.stroke();
  }
}
