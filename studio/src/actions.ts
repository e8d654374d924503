// What the user does: open files, make takes, change them, choose, delete; each can be undone.

import { bytes, send, upload } from "./api";
import { EMPTY, MOST_LETTERS, readView, writeReplay, type Replay } from "./schema";
import { scriptOf, tooLong, wrongWith } from "./script";
import {
  about, attempt, change, character, characters, comparing, doc, ended, newest, ownTakes, pause, remember, retract, say, settled, take, takes,
  time, uploading, painting, correcting,
} from "./state";
import type { Character, Doc, LibraryClip, Sentence, Settings, Take } from "./types";

export interface Made {
  job: string;
  takes: string[];
  /** The sentences as the server took them: those of a sequence in one text one by one. */
  script?: Sentence[];
}

/** Whether the bones of the file can do what the timeline says: a clip of the library moves handles. */
const rigged = (now: Doc): boolean =>
  Boolean(characters.value.find((one) => one.id === now.character)?.skeleton) && !now.script.some((part) => part.clip);

/** What generating is told, of the document. */
export function asked(now: Doc): Record<string, unknown> {
  const count = now.script.every((part) => part.clip) ? 1 : now.count; // clips alone are the same by every seed
  const seeds = Array.from({ length: count }, (_, number) => now.seed + number);
  return {
    script: now.script,
    seeds,
    steps: now.steps,
    guidance: now.guidance,
    loop: now.loop,
    in_place: now.inPlace,
    apparel: now.apparel,
    stiffness: now.stiffness,
    gravity: now.gravity,
    rig: now.rig === "own" && rigged(now) ? "own" : "handles",
    path: now.path.length > 1 ? now.path : [],
    pins: now.apparel !== "simulate" ? now.pins.filter((pin) => pin.time < now.script.reduce((sum, part) => sum + part.seconds, 0)) : [],
  };
}

/** Takes that were made: shown with their sentences, and undone by giving them up. */
export function settle(name: string, made: Made, script: Sentence[]): void {
  const sentence = script.length === doc.value.script.length ? doc.value.sentence : 0;
  const values = { take: made.takes[0] ?? null, script, sentence };
  settled(name, values, { comparing: made.takes.length > 1 }, (there) =>
    Promise.all(
      made.takes.map((id) => (there ? send("PATCH", `/takes/${id}`, { deleted: false }) : send("DELETE", `/takes/${id}`).catch(() => undefined))),
    ),
  );
}

export async function generate(force = false): Promise<void> {
  const now = doc.value;
  if (!now.character) {
    say("drop a character first, or choose a sample", true);
    return;
  }
  const wrong = wrongWith(now.script);
  if (wrong) {
    say(wrong, true);
    return;
  }
  await attempt(async () => {
    const made = await send<Made>("POST", `/characters/${now.character}/takes`, { ...asked(now), force });
    settle("generate", made, made.script ?? now.script);
    time.value = 0;
  });
}

/** Generate a part of the take anew: a span, what is not kept, what is between poses. */
export async function regenerate(prompt: string): Promise<void> {
  const now = doc.value;
  const parent = take.value;
  if (!parent) {
    return;
  }
  if (!prompt.trim() || prompt.length > MOST_LETTERS) {
    say(prompt.trim() ? tooLong(prompt) : "type what is done instead, such as: waves with both hands", true);
    return;
  }
  const seeds = Array.from({ length: now.count }, (_, number) => now.seed + number);
  await attempt(async () => {
    const made = await send<Made>("POST", `/takes/${parent.id}/change`, {
      prompt,
      seeds,
      steps: now.steps,
      guidance: now.guidance,
      keep: now.keep,
      span: now.span ?? [],
      poses: now.poses,
      pins: now.pins,
    });
    settle("change a part", made, scriptOf(parent));
  });
}

/** Bend the take to the pins, with nothing generated; a bent take is bent from the one before it was. */
export async function bend(): Promise<void> {
  const now = doc.value;
  const one = take.value;
  if (!one || one.state !== "done" || !now.pins.length) {
    return;
  }
  const parent = one.how === "bend" && one.parent ? one.parent : one.id;
  await attempt(async () => {
    const made = await send<Made>("POST", `/takes/${parent}/change`, { prompt: "", pins: now.pins });
    settle("bend to the pins", made, scriptOf(one));
    if (one.how === "bend") {
      await send("DELETE", `/takes/${one.id}`);
    }
  });
}

/** Move the hair and clothes of the take otherwise; what was dressed before is dressed from the take that it came from. */
export async function dress(): Promise<void> {
  const one = take.value;
  if (!one || one.state !== "done") {
    return;
  }
  const { apparel, stiffness, gravity } = doc.value;
  const parent = one.how === "dress" && one.parent ? one.parent : one.id;
  await attempt(async () => {
    const made = await send<Made>("POST", `/takes/${parent}/change`, { prompt: "", apparel, stiffness, gravity });
    settle("dress the take", made, scriptOf(one));
    if (one.how === "dress") {
      await send("DELETE", `/takes/${one.id}`);
    }
  });
}

/** A take of the one that is chosen with left and right exchanged, or of a stretch of it. */
export async function remake(name: string, values: { mirror: true } | { trim: [number, number] }): Promise<void> {
  const one = take.value;
  if (!one || one.state !== "done") {
    return;
  }
  await attempt(async () => {
    const made = await send<Made>("POST", `/takes/${one.id}/change`, { prompt: "", ...values });
    settle(name, made, scriptOf(one));
    time.value = 0;
  });
}

const played = (clip: LibraryClip): Sentence => ({ text: clip.sentence, seconds: Math.max(clip.seconds, 0.5), clip: clip.name });

/** Make a take of a clip of the library alone. */
export async function playClip(clip: LibraryClip): Promise<void> {
  change("play a clip", { script: [played(clip)], sentence: 0, path: [] }, { changing: false });
  pause();
  await generate();
}

/** Put a clip of the library into the timeline, before a sentence of it or at its end. */
export function addClip(clip: LibraryClip, before = doc.value.script.length): void {
  const { script } = doc.value;
  const only = script.length === 1 && !script[0]?.clip && !script[0]?.text.trim();
  const at = only ? 0 : Math.min(before, script.length);
  change("add a clip", { script: only ? [played(clip)] : [...script.slice(0, at), played(clip), ...script.slice(at)], sentence: at });
  pause();
}

export function choose(id: string): void {
  if (id !== doc.value.take) {
    change("choose a take", { take: id, ...sentencesOf(id) });
    pause();
  }
}

/** The box and the timeline show the sentences of the take that is chosen. */
function sentencesOf(id: string | null): Pick<Doc, "script" | "sentence"> {
  const one = takes.value.find((each) => each.id === id);
  return one ? { script: scriptOf(one), sentence: 0 } : { script: doc.value.script, sentence: doc.value.sentence };
}

export async function star(one: Take): Promise<void> {
  const set = (value: boolean): Promise<unknown> => send("PATCH", `/takes/${one.id}`, { star: value });
  await attempt(async () => {
    await set(!one.star);
    remember({ name: "star", undo: () => set(one.star), redo: () => set(!one.star) });
  });
}

async function giveUp(kind: "takes" | "characters", id: string, name: string): Promise<void> {
  const before = doc.value;
  await attempt(async () => {
    await send("DELETE", `/${kind}/${id}`);
    if (kind === "takes" && doc.value.take === id) {
      const next = ownTakes.value.find((one) => one.id !== id)?.id ?? null;
      doc.value = { ...doc.value, take: next, ...sentencesOf(next) };
    }
    if (kind === "characters" && doc.value.character === id) {
      switchTo(characters.value.find((one) => one.id !== id)?.id ?? null);
    }
    const after = doc.value;
    remember({
      name,
      undo: async () => {
        await send("PATCH", `/${kind}/${id}`, { deleted: false });
        doc.value = before;
      },
      redo: async () => {
        await send("DELETE", `/${kind}/${id}`);
        doc.value = after;
      },
    });
  });
}

export const deleteTake = (id: string): Promise<void> => giveUp("takes", id, "delete a take");
export const deleteCharacter = (id: string): Promise<void> => giveUp("characters", id, "delete a character");

/** What the document holds where a character is chosen. */
function ofCharacter(id: string | null): Partial<Doc> {
  const first = newest(takes.value, id);
  return { character: id, take: first?.id ?? null, ...sentencesOf(first?.id ?? null), pins: [], poses: [], path: [], span: null, apparel: "rigid" };
}

function switchTo(id: string | null): void {
  doc.value = { ...doc.value, ...ofCharacter(id) };
  comparing.value = false;
  painting.value = false;
  correcting.value = false;
  time.value = 0;
}

export function select(id: string): void {
  if (doc.value.character === id) {
    return;
  }
  pause();
  change("choose a character", ofCharacter(id), { comparing: false, changing: false });
  painting.value = false;
  correcting.value = false;
  time.value = 0;
}

/** Turn a character, change its unit or where its handles come from. */
export async function repair(one: Character, values: Partial<Settings>): Promise<void> {
  const before = one.settings;
  const set = (settings: Partial<Settings>): Promise<unknown> => send("PATCH", `/characters/${one.id}`, settings);
  await attempt(async () => {
    await set(values);
    remember({ name: "repair a character", undo: () => set(before), redo: () => set({ ...before, ...values }) });
  });
}

interface Opened {
  character: Character;
  job: string;
}

async function opened(made: Opened): Promise<void> {
  const { id } = made.character;
  characters.value = [...characters.value.filter((one) => one.id !== id), made.character];
  select(id);
  if (wrongWith(doc.value.script)) {
    doc.value = { ...doc.value, script: EMPTY.script, sentence: 0 }; // what is opened moves by itself
  }
  try {
    await ended(made.job);
  } catch (error) {
    // What cannot be read is not left chosen: the page goes back to what it showed.
    if (doc.value.character === id) {
      retract("choose a character");
    }
    await send("DELETE", `/characters/${id}`).catch(() => undefined);
    throw error;
  }
}

const sampling = new Set<string>(); // samples that are being opened

/** Open a sample and let it move; one that is open already is chosen. */
export async function sample(name: string): Promise<void> {
  const there = characters.value.find((one) => one.sample === name && one.state === "ready");
  if (there) {
    select(there.id);
    return;
  }
  if (sampling.has(name)) {
    return;
  }
  sampling.add(name);
  await attempt(async () => {
    await opened(await send<Opened>("POST", `/characters?sample=${encodeURIComponent(name)}`));
    await generate();
  });
  sampling.delete(name);
}

/** How apparel moves, as an address says it. */
const worn = (): string => `&apparel=${doc.value.apparel}&stiffness=${doc.value.stiffness}&gravity=${doc.value.gravity}`;

function suffixOf(name: string): string {
  return /\.[a-z0-9]+$/i.exec(name)?.[0].toLowerCase() ?? "";
}

/** Open a file of any kind: a character, a motion for the one that is shown, a project. */
export async function open(file: File): Promise<void> {
  const known = about.value?.reads;
  const suffix = suffixOf(file.name);
  const name = encodeURIComponent(file.name);
  if (!known) {
    return;
  }
  if (file.size > (about.value?.limits.bytes ?? Infinity)) {
    say(`${file.name}: ${Math.round(file.size / 2 ** 20)} MiB are too many, at most 200 are taken; simplify it`, true);
    return;
  }
  const told = (done: number): void => void (uploading.value = { name: file.name, done });
  told(0);
  await attempt(async () => {
    if (known.projects.includes(suffix)) {
      const found = await upload<{ character: string; takes: Record<string, string>; view: unknown }>(
        `/project-files?name=${name}`, file, told,
      );
      uploading.value = null;
      const view = readView(found.view);
      change("open a project", {
        ...view,
        character: found.character,
        take: (view.take && found.takes[view.take]) || Object.values(found.takes)[0] || null,
        poses: (view.poses ?? []).map((one) => ({ ...one, take: found.takes[one.take] ?? one.take })),
      });
    } else if (known.motions.includes(suffix)) {
      if (!character.value) {
        throw new Error("drop a character first, then the motion that it is to make");
      }
      const made = await upload<Made>(`/characters/${character.value.id}/transfer?name=${name}${worn()}`, file, told);
      uploading.value = null;
      settle("transfer a motion", made, [{ text: "", seconds: 4 }]);
      await ended(made.job);
    } else if (known.characters.includes(suffix) || suffix === ".zip") {
      const made = await upload<Opened>(`/characters?name=${name}`, file, told);
      uploading.value = null;
      await opened(made);
      await generate();
    } else {
      throw new Error(
        `${file.name}: '${suffix}' is not a format for this; characters are ${known.characters.join(", ")} and .zip, ` +
          `motions ${known.motions.join(", ")}`,
      );
    }
  });
  uploading.value = null;
}

/** Take the motion of a file that also holds a character, such as a GLB with a clip or an FBX. */
export async function openAsMotion(file: File): Promise<void> {
  const one = character.value;
  if (!one) {
    return;
  }
  await attempt(async () => {
    const made = await upload<Made>(`/characters/${one.id}/transfer?name=${encodeURIComponent(file.name)}${worn()}`, file, () => undefined);
    settle("transfer a motion", made, [{ text: "", seconds: 4 }]);
    await ended(made.job);
  });
}

/** Write takes as files of another program, each its own, or as the clips or the panes of one, and hand them to the browser. */
export async function download(some: Take[], settings: { format: string; fps: number; together: boolean; preset?: string }): Promise<void> {
  const { format, fps, together, preset } = settings;
  const written = async (path: string, body: unknown): Promise<void> => {
    const made = await send<{ job: string; export: string; title: string }>("POST", path, body);
    await ended(made.job);
    hand(new Blob([await bytes(`/exports/${made.export}`)]), made.title);
  };
  await attempt(async () => {
    const owner = some[0]?.character;
    if (preset || (together && some.length > 1)) {
      await written(`/characters/${owner}/exports`, { takes: some.map((one) => one.id), fps, ...(preset ? { preset } : { format }) });
      return;
    }
    for (const one of some) {
      await written(`/takes/${one.id}/exports`, { format, fps });
    }
  });
}

export async function saveProject(): Promise<void> {
  const one = character.value;
  if (!one) {
    return;
  }
  await attempt(async () => {
    const data = await bytes(`/characters/${one.id}/project`, {
      method: "POST",
      body: JSON.stringify({ view: doc.value }),
    });
    hand(new Blob([data]), `${one.name}.bunraku`);
  });
}

/** Give a file to the user as the browser does. */
export function hand(file: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** The address that makes a take again from its sentences and its seed. */
export function replayLink(one: Take): string {
  const told = readView(one.asked ?? {});
  const text = writeReplay({
    character: characters.value.find((each) => each.id === one.character)?.name ?? "",
    script: scriptOf(one),
    seed: one.seed,
    steps: told.steps ?? null,
    guidance: told.guidance ?? null,
    loop: told.loop ?? false,
    inPlace: Boolean(one.asked?.["in_place"]),
    path: told.path ?? [],
    apparel: told.apparel ?? "rigid",
    stiffness: told.stiffness ?? 1,
    gravity: told.gravity ?? 1,
    rig: told.rig ?? "handles",
  });
  return `${location.origin}/#replay=${text}`;
}

/** Make the take of a link: on the character of its name, on a sample of it, or on the one that is shown. */
export async function replay(link: Replay): Promise<void> {
  await attempt(async () => {
    const { character: name, ...told } = link;
    const own = characters.value.find((one) => one.name === name && one.state === "ready");
    if (own) {
      select(own.id);
    } else if (about.value?.samples.includes(name)) {
      await opened(await send<Opened>("POST", `/characters?sample=${encodeURIComponent(name)}`));
    }
    change("replay a link", { ...told, count: 1, pins: [], poses: [], sentence: 0 });
    await generate();
  });
}
