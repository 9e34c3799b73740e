// What the service tells of frames, as JSON.

export interface Box {
  center_cam: [number, number, number];
  length_m: number;
  width_m: number;
  height_m: number;
  rotation_y: number;
}

export interface Losses {
  geometric: number;
  ray_tracing: number;
  center: number;
  total: number;
}

export interface DetectedObject {
  index: number;
  class: string;
  prompt_box_px: [number, number, number, number];
  prompt_score: number;
  result: string;
  sentence: string;
  score: number;
  iou_probability: [number, number] | null;
  flags: string[];
  box: Box | null;
  losses: Losses | null;
  points: { in_prompt: number; above_ground: number; in_cluster: number; used: number };
  rejected: { reason: string; box: Box; losses: Losses | null }[];
  track: { id: number; motion: string; sightings: number } | null;
}

export type Verdict = "open" | "accepted" | "corrected" | "rejected";

export interface Opinion {
  verdict: Verdict;
  box: Box | null;
  category: string | null;
}

export interface Correction {
  sequence: number;
  frame: string;
  object_index: number;
  revision: number;
  opinion: Opinion;
  author: string;
  made_at: string;
  request_id: string;
}

export interface QueueEntry {
  frame: string;
  index: number;
  category: string;
  result: string;
  score: number;
  has_box: boolean;
  flags: string[];
  worth: number;
}

export interface Queue {
  frames: number;
  frames_read: number;
  objects: number;
  left: number;
  entries: QueueEntry[];
}

export interface FrameAnswer {
  details: {
    frame: string;
    objects: DetectedObject[];
    warnings: { name: string; sentence: string }[];
  };
  corrections: Correction[];
  missing?: string;
  image_size?: [number, number];
  image_P_cam?: number[][];
  has_image?: boolean;
  points?: number;
}
