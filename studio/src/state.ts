// What the page knows and what the user has set, as signals; undo and redo of everything; saving it as it changes.

import { batch, computed, effect, signal } from "@preact/signals";
import type { Colouring } from "./model";
import { enter, get, listen, send, ServerError } from "./api";
import { EMPTY, readDoc } from "./schema";
import { scriptOf } from "./script";
import type { About, Character, Doc, Job, Project, Take } from "./types";

export const about = signal<About | null>(null);
export const characters = signal<Character[]>([]);
export const takes = signal<Take[]>([]);
export const jobs = signal<Job[]>([]);
export const online = signal(false);
export const warm = signal(false);
/** Why nothing can be kept at the moment, and what could not be read. */
export const trouble = signal("");
export const aside = signal<string[]>([]);
export const locked = signal(false);
export const notice = signal<{ text: string; bad: boolean } | null>(null);
export const uploading = signal<{ name: string; done: number } | null>(null);

export const time = signal(0);
export const playing = signal(true);
export const speed = signal(1);
export const follow = signal(true);
export const colouring = signal<Colouring>("none");
export const weightOf = signal(0);
export const comparing = signal(false);
export const drawing = signal(false);
/** Which tab is open beside the stage, and on a phone what lies over it. */
export const side = signal<"characters" | "clips">("characters");
export const sheet = signal<"" | "characters" | "clips" | "takes" | "time">("");
/** Whether the tools that direct a take are shown, and the row that selects a stretch of it; rows of pins and poses are
 * there where there is something in them.
 */
export const unfolded = signal(false);
/** Whether hair and clothes are being painted on the mesh, and how. */
export const painting = signal(false);
/** Whether joints and parts of the body are being corrected. */
export const correcting = signal(false);
export const brush = signal({ add: true, size: 0.05 });

export const doc = signal<Doc>(EMPTY);
/** Whether the box says what is done instead of a part of the take, and those words. */
export const changing = signal(false);
export const instead = signal("waves with both hands");

/** All that undo takes back at once. */
interface Shown {
  doc: Doc;
  comparing: boolean;
  changing: boolean;
  instead: string;
}

const shown = (): Shown => ({ doc: doc.value, comparing: comparing.value, changing: changing.value, instead: instead.value });

/** Show the page as it stood. */
function show(one: Shown): void {
  batch(() => {
    doc.value = one.doc;
    comparing.value = one.comparing;
    changing.value = one.changing;
    instead.value = one.instead;
  });
}

export const character = computed(() => characters.value.find((one) => one.id === doc.value.character) ?? null);
export const take = computed(() => takes.value.find((one) => one.id === doc.value.take) ?? null);
export const ownTakes = computed(() =>
  takes.value
    .filter((one) => one.character === doc.value.character && !one.deleted)
    .sort((one, other) => other.created - one.created),
);
/** The take that a character is shown with: the newest that is done, or the newest of all. */
export function newest(all: Take[], owner: string | null): Take | null {
  const own = all.filter((one) => one.character === owner && !one.deleted).sort((one, other) => other.created - one.created);
  return own.find((one) => one.state === "done") ?? own[0] ?? null;
}
const open = (job: Job): boolean => ["waiting", "running"].includes(job.state);
/** What nobody asked for by itself: how clips look, what is found out of a character, chains over it. */
const QUIET = ["preview", "find-out", "lay-chains", "live"];
/** What is being made. */
export const running = computed(() => jobs.value.filter((job) => open(job) && !QUIET.includes(job.kind)));
export const interrupted = computed(() => jobs.value.filter((job) => job.state === "interrupted"));
export const total = computed(() => doc.value.script.reduce((sum, part) => sum + part.seconds, 0));

interface Step {
  name: string;
  undo: () => void | Promise<unknown>;
  redo: () => void | Promise<unknown>;
  /** How the page stood before, of a step that changes nothing but the page. */
  before?: Shown;
}
const done = signal<Step[]>([]);
const undone = signal<Step[]>([]);
export const canUndo = computed(() => done.value.at(-1)?.name ?? null);
export const canRedo = computed(() => undone.value.at(-1)?.name ?? null);
let last = { name: "", at: 0 };

export function remember(step: Step): void {
  done.value = [...done.value.slice(-199), step];
  undone.value = [];
  last = { name: "", at: 0 };
}

/** What is changed next is a step of its own, however soon it comes. */
export function pause(): void {
  last = { name: "", at: 0 };
}

/** Change the document, and with it whether a part of the take is changed; changes of one name in quick succession
 * (typing, dragging) are one step.
 */
export function change(name: string, values: Partial<Doc>, page: Partial<Omit<Shown, "doc">> = {}): void {
  const now = performance.now();
  const top = done.value.at(-1);
  const goesOn = top?.before && last.name === name && now - last.at < 1200 && name !== "";
  const before = (goesOn && top.before) || shown();
  show({ ...shown(), ...page, doc: { ...doc.value, ...values } });
  const after = shown();
  if (goesOn) {
    done.value = done.value.slice(0, -1);
  }
  remember({ name, before, undo: () => show(before), redo: () => show(after) });
  last = { name, at: now };
}

/** Do what is undone as one step with all that was changed on the page since a take was made or chosen: its words, its
 * path and its pins. `made` takes what it made away, or brings it back.
 */
export function settled(name: string, values: Partial<Doc>, page: Partial<Omit<Shown, "doc">>, made: (there: boolean) => Promise<unknown>): void {
  let before = shown();
  while (done.value.at(-1)?.before?.doc.take === before.doc.take && done.value.at(-1)?.before?.doc.character === before.doc.character) {
    before = done.value.at(-1)?.before as Shown;
    done.value = done.value.slice(0, -1);
  }
  show({ ...shown(), ...page, doc: { ...doc.value, ...values } });
  const after = shown();
  remember({
    name,
    undo: async () => {
      show(before);
      await made(false);
    },
    redo: async () => {
      await made(true);
      show(after);
    },
  });
}

/** Take the last step out of what can be undone, and show the page as it stood before it. */
export function retract(name: string): void {
  const top = done.value.at(-1);
  if (top?.name === name && top.before) {
    done.value = done.value.slice(0, -1);
    show(top.before);
  }
}

export async function undo(): Promise<void> {
  const step = done.value.at(-1);
  if (step) {
    done.value = done.value.slice(0, -1);
    undone.value = [...undone.value, step];
    last = { name: "", at: 0 };
    await attempt(async () => step.undo());
  }
}

export async function redo(): Promise<void> {
  const step = undone.value.at(-1);
  if (step) {
    undone.value = undone.value.slice(0, -1);
    done.value = [...done.value, step];
    last = { name: "", at: 0 };
    await attempt(async () => step.redo());
  }
}

export function say(text: string, bad = false): void {
  notice.value = { text, bad };
}

/** Run something and say what goes wrong. */
export async function attempt<T>(what: () => Promise<T>): Promise<T | undefined> {
  try {
    return await what();
  } catch (error) {
    if (error instanceof ServerError && error.status === 401) {
      locked.value = true;
    }
    say(error instanceof Error ? error.message : String(error), true);
    return undefined;
  }
}

function placed<T extends { id: string; deleted?: boolean }>(list: T[], record: T): T[] {
  const rest = list.filter((one) => one.id !== record.id);
  return record.deleted ? rest : [...rest, record];
}

function heard(what: string, data: unknown): void {
  batch(() => {
    if (what === "character") {
      characters.value = placed(characters.value, data as Character);
    } else if (what === "take") {
      takes.value = placed(takes.value, data as Take);
    } else if (what === "gone") {
      const { kind, id } = data as { kind: string; id: string };
      if (kind === "takes") {
        takes.value = takes.value.filter((one) => one.id !== id);
      } else if (kind === "characters") {
        characters.value = characters.value.filter((one) => one.id !== id);
      }
    } else if (what === "trouble") {
      trouble.value = (data as { text: string }).text;
    } else if (what === "worker") {
      warm.value = (data as { warm: boolean }).warm;
    } else if (what === "job") {
      const job = data as Job;
      if (job.kind === "live") {
        return; // who asked gets an answer
      }
      jobs.value = [...jobs.value.filter((one) => one.id !== job.id), job];
      if (job.state === "failed" && !QUIET.includes(job.kind)) {
        say(`${job.title}: ${job.error}`, true);
      }
      waiters.get(job.id)?.(job);
    }
  });
}

const waiters = new Map<string, (job: Job) => void>();

/** Wait until a job has ended. */
export function ended(id: string): Promise<Job> {
  return new Promise((resolve, reject) => {
    const look = (job: Job | undefined): void => {
      if (job && !["waiting", "running"].includes(job.state)) {
        waiters.delete(id);
        if (job.state === "done") {
          resolve(job);
        } else {
          reject(new Error(job.error || `${job.title}: ${job.state}`));
        }
      }
    };
    waiters.set(id, look);
    look(jobs.value.find((job) => job.id === id));
  });
}

function known(found: About): void {
  batch(() => {
    about.value = found;
    characters.value = found.characters;
    takes.value = found.takes;
    jobs.value = found.jobs;
    trouble.value = found.trouble;
    aside.value = found.set_aside;
    locked.value = false;
    warm.value = found.worker.warm;
  });
}

/** Where this tab's view is kept; it outlives a reload and no more. */
const PROJECT = "bunraku-project";
let project: Project | null = null;
let saved = "";
let keeping: Promise<void> = Promise.resolve();

/** Keep how the page stands; in a project of this tab's own where it has none yet, or where another tab took it. */
export function keep(view: Doc): Promise<void> {
  keeping = keeping.catch(() => undefined).then(() => put(view));
  return keeping;
}

async function put(view: Doc): Promise<void> {
  if (project) {
    try {
      project = await send<Project>("PUT", `/projects/${project.id}`, { view, revision: project.revision });
      return;
    } catch (error) {
      if (!(error instanceof ServerError) || ![404, 409].includes(error.status)) {
        throw error;
      }
    }
  }
  project = await send<Project>("POST", "/projects", { view });
  sessionStorage.setItem(PROJECT, project.id);
}

/** The view of this tab, or that which was kept last; the project that is this tab's own, if it is there. */
export function viewOf(projects: Project[], own: string | null): { view: unknown; project: Project | null } {
  const mine = projects.find((one) => one.id === own) ?? null;
  const latest = [...projects].sort((one, other) => (other.saved ?? 0) - (one.saved ?? 0))[0];
  return { view: (mine ?? latest)?.view, project: mine };
}

/** Fetch all that there is, go where the user was, and listen from there on. */
export async function start(): Promise<void> {
  await enter();
  const found = await get<About>("/about");
  known(found);
  const before = viewOf(found.projects, sessionStorage.getItem(PROJECT));
  project = before.project;
  doc.value = readDoc(before.view);
  if (!character.value || character.value.deleted) {
    const first = found.characters[0];
    doc.value = { ...doc.value, character: first?.id ?? null, take: null };
  }
  if (!take.value) {
    doc.value = { ...doc.value, take: newest(takes.value, doc.value.character)?.id ?? null };
    if (!before.view) {
      doc.value = { ...doc.value, script: scriptOf(take.value) };
    }
  }
  saved = JSON.stringify(doc.value);
  let timer = 0;
  effect(() => {
    const now = JSON.stringify(doc.value);
    clearTimeout(timer);
    if (now !== saved) {
      timer = window.setTimeout(() => {
        saved = now;
        void attempt(() => keep(JSON.parse(now) as Doc));
      }, 400);
    }
  });
  void listen(found.event, {
    heard,
    missed: async () => {
      const all = await get<About>("/about");
      known(all);
      for (const id of waiters.keys()) {
        waiters.get(id)?.(await get<Job>(`/jobs/${id}`));
      }
      return all.event;
    },
    open: (up) => (online.value = up),
    busy: () => jobs.value.some(open),
  });
}
