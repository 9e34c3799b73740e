// Points and boxes from above: x to the right, z upwards. The wheel zooms, dragging moves.
import { colorOf, corners, toCamera } from "./geometry";
import type { OpenFrame, Review } from "./review";
import type { Box } from "./types";

const RING_M = 10;

export class BirdsEyeView {
  private centerX = 0;
  private centerZ = 25;
  private pxPerM = 8;
  private frame: OpenFrame | null = null;
  private readonly points = document.createElement("canvas");
  private pointsFor = "";

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly review: Review,
  ) {
    canvas.addEventListener("wheel", (event) => this.zoom(event), { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.drag(event));
  }

  draw(): void {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    if (!width || !height) return;
    if (this.frame !== this.review.frame) {
      this.frame = this.review.frame;
      this.pointsFor = "";
      this.fit(height);
    }
    const context = this.canvas.getContext("2d")!;
    context.setTransform(1, 0, 0, 1, 0, 0);
    this.drawPoints();
    context.drawImage(this.points, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.rings(context);
    for (const item of this.review.objects) {
      const box = this.review.boxOf(item);
      const selected = item.index === this.review.selected;
      if (selected)
        item.rejected.forEach((each, at) =>
          this.box(context, each.box, colorOf(item.index), 1, at === this.review.hypothesis ? 0.9 : 0.35, true),
        );
      const rejected = this.review.opinionOf(item.index).verdict === "rejected";
      if (box) this.box(context, box, colorOf(item.index), selected ? 2.5 : 1.3, rejected ? 0.25 : 1);
    }
  }

  private fit(height: number): void {
    const depths = this.review.objects.map((each) => each.box?.center_cam[2] ?? 0);
    const farthest = Math.min(Math.max(30, ...depths) + 5, 90);
    this.pxPerM = height / (farthest + 4);
    this.centerX = 0;
    this.centerZ = farthest / 2 - 2;
  }

  private at(x: number, z: number): [number, number] {
    const { clientWidth, clientHeight } = this.canvas;
    return [clientWidth / 2 + (x - this.centerX) * this.pxPerM, clientHeight / 2 - (z - this.centerZ) * this.pxPerM];
  }

  /** Pixels of the points are computed again only where the view moved. */
  private drawPoints(): void {
    const { width, height } = this.canvas;
    const state = [width, height, this.centerX, this.centerZ, this.pxPerM, this.frame?.name].join();
    if (state === this.pointsFor || !width || !height) return;
    this.pointsFor = state;
    this.points.width = width;
    this.points.height = height;
    const context = this.points.getContext("2d")!;
    const image = context.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    pixels.fill(0xff181412);
    const ratio = window.devicePixelRatio || 1;
    const scale = this.pxPerM * ratio;
    const points = this.frame?.points ?? new Float32Array(0);
    for (let at = 0; at < points.length; at += 3) {
      const column = Math.round(width / 2 + (points[at]! - this.centerX) * scale);
      const row = Math.round(height / 2 - (points[at + 2]! - this.centerZ) * scale);
      if (column < 0 || row < 0 || column >= width || row >= height) continue;
      const shade = 70 + Math.min(Math.max((1.8 - points[at + 1]!) / 2.5, 0), 1) * 130;
      pixels[row * width + column] = 0xff000000 | (shade << 16) | (shade << 8) | shade;
    }
    context.putImageData(image, 0, 0);
  }

  private rings(context: CanvasRenderingContext2D): void {
    context.strokeStyle = context.fillStyle = "#8c929c";
    context.lineWidth = 0.5;
    context.font = "11px system-ui, sans-serif";
    for (let radius = RING_M; radius <= 100; radius += RING_M) {
      const [x, y] = this.at(0, 0);
      context.globalAlpha = 0.5;
      context.beginPath();
      context.arc(x, y, radius * this.pxPerM, 0, 2 * Math.PI);
      context.stroke();
      context.globalAlpha = 1;
      context.fillText(`${radius} m`, x + 3, y - radius * this.pxPerM - 2);
    }
  }

  private box(
    context: CanvasRenderingContext2D, box: Box, color: string, width: number, alpha: number, dashed = false,
  ): void {
    context.strokeStyle = color;
    context.lineWidth = width;
    context.globalAlpha = alpha;
    context.setLineDash(dashed ? [5, 4] : []);
    context.beginPath();
    for (const [x, , z] of corners(box).slice(0, 4)) context.lineTo(...this.at(x, z));
    context.closePath();
    const tip = toCamera(box, 0.65 * box.length_m, 0, 0);
    context.moveTo(...this.at(box.center_cam[0], box.center_cam[2]));
    context.lineTo(...this.at(tip[0], tip[2]));
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  private zoom(event: WheelEvent): void {
    event.preventDefault();
    const factor = Math.exp(-event.deltaY / 400);
    this.pxPerM = Math.min(Math.max(this.pxPerM * factor, 2), 200);
    this.draw();
  }

  /** A click selects the box under it, a drag moves the view. */
  private drag(down: PointerEvent): void {
    let moved = 0;
    this.canvas.setPointerCapture(down.pointerId);
    const move = (event: PointerEvent): void => {
      moved += Math.abs(event.movementX) + Math.abs(event.movementY);
      this.centerX -= event.movementX / this.pxPerM;
      this.centerZ += event.movementY / this.pxPerM;
      this.draw();
    };
    const up = (): void => {
      this.canvas.removeEventListener("pointermove", move);
      if (moved < 4) this.pick(down);
    };
    this.canvas.addEventListener("pointermove", move);
    this.canvas.addEventListener("pointerup", up, { once: true });
    this.canvas.addEventListener("pointercancel", up, { once: true });
  }

  private pick(event: PointerEvent): void {
    const rectangle = this.canvas.getBoundingClientRect();
    const x = event.clientX - rectangle.left;
    const y = event.clientY - rectangle.top;
    let best = 30;
    let hit = -1;
    for (const item of this.review.objects) {
      const box = this.review.boxOf(item);
      if (!box) continue;
      const [bx, by] = this.at(box.center_cam[0], box.center_cam[2]);
      const distance = Math.hypot(bx - x, by - y);
      if (distance < best) [best, hit] = [distance, item.index];
    }
    if (hit >= 0) this.review.select(hit);
  }
}
