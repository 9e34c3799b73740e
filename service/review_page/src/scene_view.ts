// Points and boxes in 3D (three.js). A picture is drawn only when something changed.
import {
  BufferAttribute, BufferGeometry, Color, LineBasicMaterial, LineSegments, PerspectiveCamera, Points,
  PointsMaterial, Scene, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { EDGES, FRONT_CROSS, colorOf, corners, toCamera } from "./geometry";
import type { OpenFrame, Review } from "./review";
import type { Box } from "./types";

export class SceneView {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(55, 1, 0.1, 500);
  private readonly controls: OrbitControls;
  private readonly points = new Points(
    new BufferGeometry(), new PointsMaterial({ size: 1.6, sizeAttenuation: false, vertexColors: true }),
  );
  private readonly boxes = new LineSegments(
    new BufferGeometry(), new LineBasicMaterial({ vertexColors: true, transparent: true }),
  );
  private frame: OpenFrame | null = null;
  private lookedAt = "";
  private drawnSize = "";
  private asked = false;

  /** Throws where the browser has no WebGL. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly review: Review,
  ) {
    this.renderer = new WebGLRenderer({ canvas, antialias: false, powerPreference: "high-performance" });
    this.scene.background = new Color("#121418");
    this.scene.add(this.points, this.boxes);
    this.points.frustumCulled = this.boxes.frustumCulled = false;
    this.camera.up.set(0, -1, 0); // y points down in the camera frame
    this.camera.position.set(0, -12, -14);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.set(0, 1, 20);
    this.controls.addEventListener("change", () => this.ask());
    this.controls.update();
  }

  draw(): void {
    if (this.frame !== this.review.frame) {
      this.frame = this.review.frame;
      this.lookedAt = "";
      this.showPoints();
    }
    this.showBoxes();
    this.lookAtSelected();
    this.ask();
  }

  /** Frames a second while the view turns for some seconds, as fast as it can. */
  async measureFrameRate(seconds: number): Promise<number> {
    const start = performance.now();
    let count = 0;
    while (performance.now() - start < 1000 * seconds) {
      const around = this.controls.target;
      const offset = this.camera.position.clone().sub(around).applyAxisAngle(new Vector3(0, 1, 0), 0.02);
      this.camera.position.copy(around).add(offset);
      this.camera.lookAt(around);
      this.render();
      // Until the picture is there: commands alone are queued faster than they are drawn.
      this.renderer.getContext().finish();
      count += 1;
      await new Promise(requestAnimationFrame);
    }
    return (1000 * count) / (performance.now() - start);
  }

  private ask(): void {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.render();
    });
  }

  private render(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const size = `${width} ${height} ${window.devicePixelRatio}`;
    if (size !== this.drawnSize) {
      this.drawnSize = size;
      this.renderer.setPixelRatio(window.devicePixelRatio || 1);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    this.renderer.render(this.scene, this.camera);
  }

  private showPoints(): void {
    const points = this.frame?.points ?? new Float32Array(0);
    const colors = new Uint8Array(points.length);
    for (let at = 0; at < points.length; at += 3) {
      const up = Math.min(Math.max((1.8 - points[at + 1]!) / 3, 0), 1);
      colors[at] = 70 + 110 * up;
      colors[at + 1] = 90 + 110 * up;
      colors[at + 2] = 120 + 110 * up;
    }
    this.points.geometry.dispose();
    this.points.geometry = new BufferGeometry()
      .setAttribute("position", new BufferAttribute(points, 3))
      .setAttribute("color", new BufferAttribute(colors, 3, true));
  }

  private showBoxes(): void {
    const positions: number[] = [];
    const colors: number[] = [];
    const add = (box: Box, color: string, strength: number): void => {
      const shade = new Color(color).lerp(new Color("#121418"), 1 - strength);
      const ends = corners(box);
      for (const [a, b] of [...EDGES, ...FRONT_CROSS]) {
        positions.push(...ends[a]!, ...ends[b]!);
        colors.push(shade.r, shade.g, shade.b, shade.r, shade.g, shade.b);
      }
      positions.push(...box.center_cam, ...toCamera(box, 0.65 * box.length_m, 0, 0));
      colors.push(shade.r, shade.g, shade.b, shade.r, shade.g, shade.b);
    };
    for (const item of this.review.objects) {
      const box = this.review.boxOf(item);
      const selected = item.index === this.review.selected;
      const rejected = this.review.opinionOf(item.index).verdict === "rejected";
      if (box) add(box, selected ? "#ffffff" : colorOf(item.index), rejected ? 0.25 : 1);
      if (selected)
        item.rejected.forEach((each, at) =>
          add(each.box, colorOf(item.index), at === this.review.hypothesis ? 0.9 : 0.35),
        );
    }
    this.boxes.geometry.dispose();
    this.boxes.geometry = new BufferGeometry()
      .setAttribute("position", new BufferAttribute(new Float32Array(positions), 3))
      .setAttribute("color", new BufferAttribute(new Float32Array(colors), 3));
  }

  /** The view goes along when another object is selected, and stays while its box is edited. */
  private lookAtSelected(): void {
    const item = this.review.object;
    const looked = `${this.frame?.name}/${item?.index}`;
    const box = item && this.review.boxOf(item);
    if (!box || looked === this.lookedAt) return;
    this.lookedAt = looked;
    const [x, y, z] = box.center_cam;
    const distance = Math.hypot(x, z) || 1;
    this.controls.target.set(x, y, z);
    this.camera.position.set(x - (9 * x) / distance, y - 5, z - (9 * z) / distance);
    this.controls.update();
  }
}
