// What the server says, in types. See src/bunraku/studio/routes for the routes.

export type Vec3 = [number, number, number];

export interface Settings {
  up: string;
  front: string;
  unit: string;
  handles: "predict" | "rig";
}

export interface LimbEnd {
  part: string;
  handle: number;
  point: Vec3;
}

export interface Character {
  id: string;
  name: string;
  state: "opening" | "ready" | "failed" | "cancelled" | "interrupted";
  error: string;
  version: number;
  settings: Settings;
  deleted?: boolean;
  axes?: { up: string; front: string; sure: number; other: [string, string] | null };
  unit?: { unit: string; likely: string; note: string };
  vertices?: number;
  height?: number;
  bounds?: [Vec3, Vec3];
  joints?: number;
  rig?: boolean;
  physics?: boolean;
  /** Whether there are hair or clothes that can be learned. */
  apparel?: boolean;
  mmd?: boolean;
  roles?: number[];
  positions?: Vec3[];
  used?: number[];
  ends?: LimbEnd[];
  clips?: string[];
}

export type Apparel = "rigid" | "simulate" | "learn";

export interface Sentence {
  text: string;
  seconds: number;
}

export interface Take {
  id: string;
  character: string;
  created: number;
  state: "waiting" | "draft" | "done" | "failed" | "cancelled" | "interrupted";
  error: string;
  how: "animate" | "edit" | "bend" | "dress" | "transfer";
  star: boolean;
  title?: string;
  seed: number;
  script: Sentence[];
  parent?: string;
  asked?: Record<string, unknown>;
  skin?: "handles" | "bones";
  /** Of learned apparel; null where it is not learned. */
  stiffness?: number | null;
  fps?: number;
  frames?: number;
  seconds?: number;
  deleted?: boolean;
}

export interface Job {
  id: string;
  kind: string;
  title: string;
  state: "waiting" | "running" | "done" | "failed" | "cancelled" | "interrupted";
  stage: string;
  done: number;
  error: string;
  about: { character?: string; takes?: string[]; opens?: string; export?: string };
}

export interface About {
  version: string;
  limits: { bytes: number; seconds: number; takes: number };
  reads: { characters: string[]; motions: string[]; projects: string[] };
  writes: string[];
  samples: string[];
  study: boolean;
  worker: { warm: boolean; process: number };
  event: number;
  characters: Character[];
  takes: Take[];
  /** Why nothing can be kept at the moment, "" where it can. */
  trouble: string;
  /** What could not be read and is kept aside, a sentence each. */
  set_aside: string[];
  projects: Project[];
  jobs: Job[];
}

/** How a page stood. */
export interface Project {
  id: string;
  revision: number;
  saved?: number;
  view: unknown;
}

export interface Understanding {
  ok: boolean;
  language: string;
  english: string;
  unknown: { word: string; start: number; stop: number }[];
  corrected: [string, string][];
  nearest: string[];
  notes: string[];
}

export interface Pin {
  part: string;
  time: number;
  position: Vec3;
  hold: number;
}

export interface Pose {
  time: number;
  take: string;
  at: number;
}

/** What a project holds: all that undo takes back. */
export interface Doc {
  character: string | null;
  take: string | null;
  script: Sentence[];
  sentence: number;
  seed: number;
  count: 1 | 4;
  loop: boolean;
  inPlace: boolean;
  apparel: Apparel;
  stiffness: number;
  guidance: number;
  steps: number;
  pins: Pin[];
  poses: Pose[];
  path: [number, number][];
  span: [number, number] | null;
  keep: string[];
}
