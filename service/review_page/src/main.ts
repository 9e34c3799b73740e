// The review page: parts of the document, and what connects them.
import { actionFor, actionsOf } from "./actions";
import { getJson, onKeyNeeded } from "./api";
import { BirdsEyeView } from "./birds_eye_view";
import { CropView } from "./crop_view";
import { sendFrame } from "./dropping";
import { ImageView } from "./image_view";
import { ObjectPanel, element } from "./object_panel";
import { QueueList } from "./queue_list";
import { Review } from "./review";
import { SceneView } from "./scene_view";

const HEARTBEAT_MS = 4000;
const AUTHOR = "boxlift-author";

function part<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

let drawing = false;
const review = new Review(() => {
  // Said at once, and not with the next picture: whoever waits for it may not see what was before.
  document.documentElement.dataset["saved"] = String(review.isSaved);
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    draw();
  });
});

let classes: string[] = [];
const imageView = new ImageView(part("image"), review);
const birdsEyeView = new BirdsEyeView(part("birds-eye"), review);
const cropView = new CropView({ side: part("side"), front: part("front"), top: part("top") }, review);
const panel = new ObjectPanel(part("object-title"), part("facts"), part("class"), review, () => classes);
const queueList = new QueueList(part("queue"), part("progress"), review, (frame, index) =>
  guarded(() => openFrame(frame, index)),
);
let sceneView: SceneView | null = null;
try {
  sceneView = new SceneView(part("scene"), review);
} catch {
  part("no-webgl").hidden = false;
}

const actions = actionsOf(
  review,
  (step) =>
    guarded(async () => {
      let entry = review.nextEntry(step);
      if (!entry && step > 0) {
        // The page has the first thousand: those that are open now may be others.
        await review.flush();
        await review.refreshQueue();
        entry = review.firstEntry();
      }
      if (entry) await openFrame(entry.frame, entry.index);
      else if (step > 0) say("The queue has nothing more that is open.");
    }),
  () => part<HTMLSelectElement>("class").focus(),
);

function draw(): void {
  // First, for what is hidden has no size to draw into.
  part("start").hidden = review.frame !== null;
  part("views").hidden = review.frame === null;
  imageView.draw();
  birdsEyeView.draw();
  sceneView?.draw();
  cropView.draw();
  panel.draw();
  queueList.draw();
  const status = part("status");
  if (review.status && status.textContent !== review.status) status.textContent = review.status;
  status.classList.toggle("failing", review.failing);
  const warnings = review.frame?.answer.details.warnings.map((each) => each.sentence) ?? [];
  const missing = review.frame?.answer.missing;
  const alerts = missing ? [...warnings, missing] : warnings;
  part("warnings").replaceChildren(...alerts.map((each) => element("p", each)));
}

function say(text: string, failing = false): void {
  review.status = text;
  review.failing = failing;
  part("status").textContent = text;
  part("status").classList.toggle("failing", failing);
}

async function guarded(work: () => Promise<void>): Promise<void> {
  try {
    await work();
  } catch (error) {
    say(error instanceof Error ? error.message : String(error), true);
  }
}

let lost = false;

/** Hear what others did; and say when the service is gone, and when it is back. */
async function beat(): Promise<void> {
  try {
    await review.heartbeat();
    const queue = review.queue;
    if (queue && queue.frames_read < queue.frames) await review.refreshQueue();
    if (lost && review.isSaved) say("The service answers again.");
    lost = false;
  } catch {
    lost = true;
    if (review.isSaved) say("The service does not answer.", true);
  }
}

async function openFrame(frame: string, index: number): Promise<void> {
  await review.openFrame(frame, index);
  const place = new URLSearchParams({ set: review.labelSet, frame, object: String(review.selected) });
  history.replaceState(null, "", `#${place.toString()}`);
}

async function openSet(name: string): Promise<void> {
  await review.openSet(name);
  part<HTMLSelectElement>("label-set").value = name;
}

async function listSets(): Promise<string[]> {
  const answer = await getJson<{ label_sets: string[]; author: string | null; classes: string[] }>("/review/label-sets");
  classes = answer.classes;
  const author = part<HTMLInputElement>("author");
  if (answer.author) {
    author.value = answer.author;
    author.readOnly = true;
  }
  part("label-set").replaceChildren(...answer.label_sets.map((name) => new Option(name, name)));
  return answer.label_sets;
}

/** Open what the address names, if anything; a link to an object can be passed on. */
async function openPlace(names: string[]): Promise<boolean> {
  const place = new URLSearchParams(location.hash.slice(1));
  const name = place.get("set") ?? "";
  const frame = place.get("frame");
  if (!names.includes(name)) return false;
  if (name !== review.labelSet) await openSet(name);
  if (frame) await openFrame(frame, Number(place.get("object") ?? -1));
  return frame !== null;
}

async function openFirst(name: string): Promise<void> {
  if (name !== review.labelSet) await openSet(name);
  const first = review.queue?.entries[0];
  if (first) await openFrame(first.frame, first.index);
}

async function start(): Promise<void> {
  const author = part<HTMLInputElement>("author");
  author.value = localStorage.getItem(AUTHOR) ?? "";
  review.author = author.value;
  author.addEventListener("change", () => {
    review.author = author.value;
    localStorage.setItem(AUTHOR, author.value);
  });
  // What was typed is done: the keys act on boxes again.
  author.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === "Escape") author.blur();
  });
  const names = await listSets();
  const first = names[0];
  if (!(await openPlace(names)) && first) await openFirst(review.labelSet || first);
}

async function takeFiles(files: File[]): Promise<void> {
  if (!files.length) return;
  say("Labelling …");
  const { label_set, frame } = await sendFrame(files);
  await listSets();
  await openSet(label_set);
  const first = review.queue?.entries.find((each) => each.frame === frame);
  await openFrame(frame, first?.index ?? -1);
  const boxes = review.objects.filter((each) => each.box).length;
  say(`${boxes} of ${review.objects.length} objects have a box. They are kept in ${label_set}.`);
}

onKeyNeeded((refused) => {
  const dialog = part<HTMLDialogElement>("key-dialog");
  const input = part<HTMLInputElement>("key");
  part("key-refused").hidden = !refused;
  input.value = "";
  dialog.showModal();
  return new Promise((resolve) => {
    part("key-form").addEventListener(
      "submit",
      (event) => {
        event.preventDefault();
        dialog.close();
        resolve(input.value.trim());
      },
      { once: true },
    );
  });
});

const buttons = actions
  .filter((each) => each.button)
  .map((action) => {
    const button = element("button", action.label) as HTMLButtonElement;
    button.type = "button";
    button.append(element("kbd", action.keys[0]!));
    button.addEventListener("click", () => void action.run(false));
    return button;
  });
part("buttons").append(...buttons);
part("keys").append(
  ...actions.flatMap((each) => [element("dt", each.keys.join(" or ")), element("dd", each.label)]),
);

document.addEventListener("keydown", (event) => {
  const target = event.target as HTMLElement;
  if (event.key === "?" && !target.closest("input, select, dialog")) {
    part<HTMLDialogElement>("help-dialog").showModal();
    return;
  }
  if (event.key === "Escape" && target.id === "class") target.blur();
  const action = review.frame ? actionFor(actions, event) : null;
  if (!action) return;
  event.preventDefault();
  void action.run(event.shiftKey);
});
part("help").addEventListener("click", () => part<HTMLDialogElement>("help-dialog").showModal());
part("class").addEventListener("change", () => part("class").blur());
part("label-set").addEventListener("change", (event) =>
  void guarded(() => openFirst((event.target as HTMLSelectElement).value)),
);
part<HTMLInputElement>("files").addEventListener("change", (event) => {
  const input = event.target as HTMLInputElement;
  const files = [...(input.files ?? [])];
  input.value = "";
  void guarded(() => takeFiles(files));
});
document.addEventListener("dragover", (event) => event.preventDefault());
document.addEventListener("drop", (event) => {
  event.preventDefault();
  void guarded(() => takeFiles([...(event.dataTransfer?.files ?? [])]));
});
window.addEventListener("hashchange", () => void guarded(async () => void (await openPlace(await listSets()))));
window.addEventListener("resize", draw);
window.addEventListener("beforeunload", (event) => {
  if (review.isSaved) return;
  void review.flush();
  event.preventDefault();
});
window.setInterval(() => {
  if (document.hidden || !review.labelSet) return;
  void beat();
}, HEARTBEAT_MS);

// For measurements of the page.
Object.assign(window, {
  boxlift: {
    measureFrameRate: (seconds: number) => sceneView?.measureFrameRate(seconds) ?? 0,
  },
});
draw();
void guarded(start);
