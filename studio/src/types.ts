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
  /** The sample that it is a copy of. */
  sample?: string;
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
  /** Whether the bones of the file can be moved. */
  skeleton?: boolean;
  /** The version of which there is a picture. */
  picture?: number;
  roles?: number[];
  positions?: Vec3[];
  used?: number[];
  ends?: LimbEnd[];
  clips?: string[];
  /** Chains of bones over its hair and clothes, how often they were laid, and why there are none. */
  chains?: Chain[];
  laid?: number;
  unchained?: string;
  /** Whether somebody painted what its hair and clothes are. */
  painted?: boolean;
  body?: Body;
  /** Hair, clothes and what is held or worn. */
  dress?: Body["parts"];
}

/** What was found of a body and what a person said about it (src/bunraku/core/body/corrections.py); places in metres. */
export interface Body {
  joints: { name: string; parent: string | null; point: Vec3 }[];
  parts: { kind: string; at: Vec3; area: number }[];
  said: Said;
}

export interface Said {
  joints: Record<string, Vec3>;
  part: { kind: string; at: Vec3[] }[];
}

export type Apparel = "rigid" | "simulate" | "chains" | "learn";

/** A chain of bones over hair or clothes: its points at rest [m], and the handle that carries it. */
export interface Chain {
  name: string;
  kind: string;
  joint: number;
  points: Vec3[];
}

export interface Sentence {
  text: string;
  seconds: number;
  /** Whether it is as long as what is done; `seconds` is then what that takes. */
  fits?: boolean;
  /** The clip of the library that is played; without it the sentence is generated. */
  clip?: string;
}

/** A clip of the library. */
export interface LibraryClip {
  name: string;
  sentence: string;
  seconds: number;
  loops: boolean;
  tags: string[];
  credit: string;
  terms: string;
}

export interface Take {
  id: string;
  character: string;
  created: number;
  state: "waiting" | "draft" | "done" | "failed" | "cancelled" | "interrupted";
  error: string;
  how: "animate" | "edit" | "bend" | "dress" | "mirror" | "trim" | "transfer" | "live";
  star: boolean;
  title?: string;
  seed: number;
  script: Sentence[];
  parent?: string;
  asked?: Record<string, unknown>;
  skin?: "handles" | "bones";
  /** Of apparel that moves on its own, and how; null where it does not. */
  stiffness?: number | null;
  gravity?: number | null;
  worn?: "learn" | "chains" | null;
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

/** What a program wants of a file (src/bunraku/files/presets.py). */
export interface Preset {
  name: string;
  title: string;
  suffix: string;
  fps: number;
  note: string;
}

export interface About {
  version: string;
  limits: { bytes: number; seconds: number; takes: number };
  reads: { characters: string[]; motions: string[]; projects: string[] };
  writes: string[];
  /** What programs want of a file. */
  presets?: Preset[];
  /** Fewest and most frames a second of a file. */
  fps: [number, number];
  samples: string[];
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
  /** Names of clips of the library that fit. */
  clips: string[];
  notes: string[];
  /** How long it lasts where no length is asked for; null where it is refused. */
  seconds: number | null;
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
  gravity: number;
  /** Whether springs swing in the page, in place of what the take says of hair and clothes. */
  live: boolean;
  /** Null takes the few steps that the network was distilled into, with their guidance. */
  guidance: number | null;
  steps: number | null;
  pins: Pin[];
  poses: Pose[];
  path: [number, number][];
  span: [number, number] | null;
  keep: string[];
  /** What moves: the handles, or the bones of the file's own skeleton. */
  rig: "handles" | "own";
}

/** Which vertices of a character are hair and clothes. */
export interface Worn {
  /** A byte for each vertex of the character. */
  mask: Uint8Array;
  /** Which of them each row of a primitive is, by mesh and primitive: "0:1". */
  rows: Map<string, Uint32Array>;
  /** The part of each vertex, from 1 on in the order of the record's `dress`; 0 is the body. */
  numbers?: Uint16Array;
}
