// A frame that is dropped onto the page, or chosen: which file is what, by its name's end.
import { request } from "./api";

const KINDS: Record<string, string> = {
  bin: "points", npy: "points", npz: "points", pcd: "points", ply: "points",
  png: "image", jpg: "image", jpeg: "image",
  txt: "calib", json: "calib",
};
const NEEDED = ["points", "calib", "image"];

/** Sends the files; returns where the frame is then. Throws with a sentence for what is missing. */
export async function sendFrame(files: File[]): Promise<{ label_set: string; frame: string }> {
  const form = new FormData();
  const found = new Map<string, string>();
  for (const file of files) {
    const kind = KINDS[file.name.split(".").pop()?.toLowerCase() ?? ""];
    if (!kind) throw new Error(`${file.name} is none of points (.bin .npy .npz .pcd .ply), image, calibration.`);
    const other = found.get(kind);
    if (other) throw new Error(`${other} and ${file.name} are both ${kind}; drop one frame at a time.`);
    found.set(kind, file.name);
    form.append(kind, file, file.name);
  }
  const missing = NEEDED.filter((kind) => !found.has(kind));
  if (missing.length)
    throw new Error(`${missing.join(" and ")} missing: drop points, image and calibration of a frame together.`);
  return (await (await request("/review/frames", { method: "POST", body: form })).json()) as {
    label_set: string;
    frame: string;
  };
}
