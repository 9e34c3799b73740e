// What can be done with the selected object, each with its keys: the one list for keyboard, buttons and help.
import { wrapped } from "./geometry";
import type { Review } from "./review";
import type { Box } from "./types";

const STEP_M = 0.05;
const STEP_RAD = Math.PI / 180;
const FAST = 10;
const LEAST_SIDE_M = 0.2;

export interface Action {
  keys: string[];
  label: string;
  /** Shown as a button. */
  button?: boolean;
  run: (fast: boolean) => void | Promise<void>;
}

export function actionsOf(review: Review, open: (step: 1 | -1) => Promise<void>, focusClass: () => void): Action[] {
  const nudge = (axis: 0 | 1 | 2, sign: number) => (fast: boolean) =>
    review.edit((box) => {
      const center: Box["center_cam"] = [...box.center_cam];
      center[axis] = rounded(center[axis] + sign * STEP_M * (fast ? FAST : 1));
      return { ...box, center_cam: center };
    });
  const turn = (angle: (fast: boolean) => number) => (fast: boolean) =>
    review.edit((box) => ({ ...box, rotation_y: rounded(wrapped(box.rotation_y + angle(fast))) }));
  const resize = (side: "length_m" | "width_m" | "height_m", sign: number) => (fast: boolean) =>
    review.edit((box) => ({
      ...box, [side]: Math.max(LEAST_SIDE_M, rounded(box[side] + sign * STEP_M * (fast ? FAST : 1))),
    }));
  const sayAndGoOn = (verdict: "accepted" | "rejected") => async () => {
    const item = review.object;
    if (!item) return;
    const edited = verdict === "accepted" ? review.opinionOf(item.index) : null;
    // A corrected box that is accepted stays corrected.
    if (edited?.verdict !== "corrected") review.say({ verdict, box: null, category: null });
    await open(1);
  };
  return [
    { keys: ["a"], label: "Accept", button: true, run: sayAndGoOn("accepted") },
    { keys: ["r"], label: "Reject", button: true, run: sayAndGoOn("rejected") },
    { keys: ["f"], label: "Flip heading", button: true, run: turn(() => Math.PI) },
    { keys: ["u", "Ctrl+z"], label: "Undo", button: true, run: () => void review.undo() },
    { keys: ["n"], label: "Next", button: true, run: () => open(1) },
    { keys: ["p"], label: "Previous", button: true, run: () => open(-1) },
    { keys: ["h"], label: "Take the next rejected hypothesis", button: true, run: () => nextHypothesis(review) },
    { keys: ["c"], label: "Change class", run: () => focusClass() },
    { keys: ["ArrowLeft"], label: "Move left", run: nudge(0, -1) },
    { keys: ["ArrowRight"], label: "Move right", run: nudge(0, 1) },
    { keys: ["ArrowUp"], label: "Move away", run: nudge(2, 1) },
    { keys: ["ArrowDown"], label: "Move nearer", run: nudge(2, -1) },
    { keys: ["PageUp"], label: "Move up", run: nudge(1, -1) },
    { keys: ["PageDown"], label: "Move down", run: nudge(1, 1) },
    { keys: ["q"], label: "Turn left", run: turn((fast) => -STEP_RAD * (fast ? FAST : 1)) },
    { keys: ["e"], label: "Turn right", run: turn((fast) => STEP_RAD * (fast ? FAST : 1)) },
    { keys: ["]"], label: "Longer", run: resize("length_m", 1) },
    { keys: ["["], label: "Shorter", run: resize("length_m", -1) },
    { keys: ["."], label: "Wider", run: resize("width_m", 1) },
    { keys: [","], label: "Narrower", run: resize("width_m", -1) },
    { keys: ["="], label: "Higher", run: resize("height_m", 1) },
    { keys: ["-"], label: "Lower", run: resize("height_m", -1) },
  ];
}

/** The box of the next hypothesis that was rejected becomes the corrected one; after the last, the first. */
function nextHypothesis(review: Review): void {
  const item = review.object;
  if (!item?.rejected.length) return;
  review.hypothesis = (review.hypothesis + 1) % item.rejected.length;
  const box = item.rejected[review.hypothesis]!.box;
  review.say({ verdict: "corrected", box, category: review.classOf(item) }, { soon: true });
}

function rounded(value: number): number {
  return Math.round(value * 1e4) / 1e4;
}

/** The action of a key press; none while somebody types or chooses, or holds a modifier that is not its own. */
export function actionFor(actions: Action[], event: KeyboardEvent): Action | null {
  const target = event.target as HTMLElement;
  if (target.closest("input:not([type=file]), select, textarea, dialog")) return null;
  if (event.altKey || event.metaKey) return null;
  // Space and Enter press what has the focus; arrows move within the queue.
  if (target.closest("[role=listbox]") && event.key.startsWith("Arrow")) return null;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const name = (event.ctrlKey ? "Ctrl+" : "") + (SHIFTED[key] ?? key);
  return actions.find((each) => each.keys.includes(name)) ?? null;
}

const SHIFTED: Record<string, string> = { "{": "[", "}": "]", "<": ",", ">": ".", "+": "=", _: "-" };
