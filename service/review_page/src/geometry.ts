// Boxes in the rectified camera frame: x right, y down, z forward; metres and radians.
import type { Box } from "./types";

export type Vector = [number, number, number];

export const EDGES: readonly [number, number][] = [
  [0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7],
];
// Diagonals of the face that looks along the heading.
export const FRONT_CROSS: readonly [number, number][] = [[0, 7], [3, 4]];

/** A point of the box's own frame (along its length, down, across) in the camera frame. */
export function toCamera(box: Box, along: number, down: number, across: number): Vector {
  const cos = Math.cos(box.rotation_y);
  const sin = Math.sin(box.rotation_y);
  const [x, y, z] = box.center_cam;
  return [x + cos * along + sin * across, y + down, z - sin * along + cos * across];
}

/** Bottom face first: front left, rear left, rear right, front right; then the top face. */
export function corners(box: Box): Vector[] {
  const along = box.length_m / 2;
  const across = box.width_m / 2;
  const ring: [number, number][] = [[along, across], [-along, across], [-along, -across], [along, -across]];
  const down = box.height_m / 2;
  return [down, -down].flatMap((level) => ring.map(([a, c]) => toCamera(box, a, level, c)));
}

/** A point of the camera frame in the box's own: along its length, down, across. */
export function toBox(box: Box, x: number, y: number, z: number): Vector {
  const cos = Math.cos(box.rotation_y);
  const sin = Math.sin(box.rotation_y);
  const dx = x - box.center_cam[0];
  const dz = z - box.center_cam[2];
  return [cos * dx - sin * dz, y - box.center_cam[1], sin * dx + cos * dz];
}

/** Pixels of a point, null behind the camera. */
export function project(P: number[][], [x, y, z]: Vector): [number, number] | null {
  const row = (r: number[]): number => r[0]! * x + r[1]! * y + r[2]! * z + r[3]!;
  const depth = row(P[2]!);
  return depth < 0.2 ? null : [row(P[0]!) / depth, row(P[1]!) / depth];
}

/** Angle in [-pi, pi). */
export function wrapped(angle: number): number {
  return angle - 2 * Math.PI * Math.floor((angle + Math.PI) / (2 * Math.PI));
}

const PALETTE = [
  "#ff8c28", "#46c8ff", "#ff5aaa", "#fae13c", "#a082ff", "#5ae682", "#ff5f50", "#3ce1cd", "#d7aa78", "#96be5a",
];

/** The colour of an object: shared by all views. */
export function colorOf(index: number): string {
  return PALETTE[index % PALETTE.length]!;
}
