// The viewport: loads what is chosen, plays it, and answers the pointer.

import { effect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Color } from "three";
import { bend, choose } from "./actions";
import { bytes } from "./api";
import { parseClip, type Clip } from "./clip";
import { jointsOf, moveJoint, sayKind } from "./correct";
import { colour, dispose, forget, handleColour, loadModel, type Model, type Tint } from "./model";
import { numbered, pick, Picked, picked, tintOf, touched } from "./parts";
import {
  about, attempt, change, character, characters, colouring, comparing, correcting, doc, drawing, follow, ownTakes, painting, playing, running, speed,
  take, takes, time, warm, weightOf,
} from "./state";
import { finish, living, stream } from "./live";
import { lift, touch, worn } from "./painting";
import { BARE, skeletonOf, strandsOf } from "./skeleton";
import type { Character, Take } from "./types";
import { Thumbs } from "./thumbs";
import { Viewer, type Pane } from "./viewer";

export let viewer: Viewer | null = null;

/** What is painted as hair and clothes. */
const WORN = new Color(0xd9622b);
const models = new Map<string, Promise<Model>>();
const clips = new Map<string, Promise<Clip>>();
const KEPT = 24;

function model(owner: string, version: number, skin: string, laid = 0): Promise<Model> {
  const key = `${owner}:${version}:${skin}:${laid}`;
  let found = models.get(key);
  if (!found) {
    found = bytes(`/characters/${owner}/mesh.glb?skin=${skin}`).then((data) => loadModel(key, data, skin === "chains"));
    found.catch(() => models.delete(key));
    models.set(key, found);
    for (const [old, value] of [...models].slice(0, -4)) {
      models.delete(old);
      void value.then(dispose).catch(() => undefined);
    }
  }
  return found;
}

function clip(one: Take): Promise<Clip> {
  const key = `${one.id}:${one.state}`;
  let found = clips.get(key);
  if (!found) {
    found = bytes(`/takes/${one.id}/clip`).then(parseClip);
    found.catch(() => clips.delete(key));
    clips.set(key, found);
    for (const [old, value] of [...clips].slice(0, -KEPT)) {
      clips.delete(old);
      void value.then(forget).catch(() => undefined);
    }
  }
  return found;
}

/** Between frames [s], above which a browser draws with the processor, and how long it then rests [ms]; of SwiftShader's
 * frames, which take 0.1 to 0.8 s at these sizes.
 */
const SLOW = 0.09;
const REST = 1500;
const PICTURED = 400; // milliseconds after the last take until a card's picture is drawn; chosen by eye

export const seconds = (): number => Math.max(0, ...(viewer?.panes ?? []).map((pane) => pane.clip?.seconds ?? 0));

/** Takes that are shown side by side: the starred ones, or those of the latest batch. */
export function compared(): Take[] {
  const ready = ownTakes.value.filter((one) => one.state === "done" || one.state === "draft");
  const starred = ready.filter((one) => one.star);
  const chosen = take.value;
  const batch = ready.filter((one) => chosen && Math.abs(one.created - chosen.created) < 1 && one.how === chosen.how);
  const some = batch.length > 1 ? batch : starred.length > 1 ? starred : ready;
  return some.slice(0, 4).sort((one, other) => one.seed - other.seed);
}

let shown = "";
let framed = "";
let pictured = "";

/** The sign of life that the page began with stays until there is something to see. */
function awake(): void {
  const waking = document.getElementById("waking");
  const wait = !about.value || (character.value?.state === "opening" || character.value?.state === "ready");
  if (waking) {
    waking.hidden = Boolean(viewer?.panes.length) || !wait;
  }
}

async function refresh(): Promise<void> {
  const owner = character.value;
  const view = viewer;
  if (!view) {
    return;
  }
  if (!owner || !owner.version) {
    view.show([]);
    shown = "";
    awake();
    return;
  }
  if (living.value && living.value.owner !== owner.id) {
    finish(); // another one was chosen
  }
  const one = take.value;
  const live = lively();
  const bound = painting.value || correcting.value; // as it rests
  const alive = stream && living.value ? stream : null;
  const several = painting.value || alive || correcting.value ? [] : comparing.value ? compared() : [];
  const wanted = several.length > 1 ? several : one && one.state !== "waiting" && one.fps && !bound && !alive ? [one] : [];
  if (!wanted.length && !alive && !bound && doc.value.take && shown.startsWith(`["${owner.id}",${owner.version},`)) {
    return; // what is shown stays until the new take is there
  }
  const skins = wanted.map((each) => (live && several.length < 2 && each.skin !== "bones" ? "chains" : (each.skin ?? "handles")));
  const laid = skins.includes("chains") ? (owner.laid ?? 0) : 0;
  const key = JSON.stringify([owner.id, owner.version, wanted.map((each, number) => [each.id, each.state, skins[number]]), laid, bound, Boolean(alive)]);
  if (key === shown || owner.state !== "ready") {
    return;
  }
  const before = shown;
  shown = key;
  await attempt(async () => {
    try {
      const panes: Pane[] = wanted.length
        ? await Promise.all(
            wanted.map(async (each, number) => ({
              model: await model(owner.id, owner.version, skins[number] ?? "handles", laid),
              clip: await clip(each),
              label: each.id,
              draft: each.state === "draft",
            })),
          )
        : [{ model: await model(owner.id, owner.version, "handles"), clip: alive?.clip ?? null, bound }];
      if (key !== shown) {
        return; // something else was chosen meanwhile
      }
      view.show(panes);
      awake();
      const frame = `${owner.id}:${owner.version}`;
      if (frame !== framed && !correcting.value) {
        view.frame(owner.bounds); // what is corrected stays in view as it is
      }
      framed = frame;
      const moving = panes[0]?.clip;
      if (owner.picture !== owner.version && pictured !== frame && moving && !alive && !correcting.value) {
        pictured = frame;
        const there = (): boolean => characters.value.some(({ id, version, state }) => `${id}:${version}:${state}` === `${frame}:ready`);
        void quiet()
          .then(() => (there() ? photograph(owner, skins[0] === "bones" ? null : moving) : undefined))
          .catch(() => undefined); // it is no loss
      }
      paint();
    } catch (error) {
      shown = before;
      throw error;
    }
  });
}

/** When nothing is being made any more, and a moment later: what comes first is what was asked for. */
const quiet = (): Promise<void> =>
  new Promise((resolve) => {
    const stop = effect(() => {
      if (!running.value.length) {
        setTimeout(() => (stop(), resolve()), PICTURED);
      }
    });
  });

/** Keep a picture of a character for its card: moments of what it does now, which move when the card is pointed at. */
async function photograph(owner: Character, shown: Clip | null): Promise<void> {
  const thumbs = new Thumbs();
  await thumbs.show(owner.id, await bytes(`/characters/${owner.id}/mesh.glb?skin=handles`), owner.bounds);
  const card = shown ? thumbs.strip(shown) : thumbs.picture(0.08);
  thumbs.end();
  const data = await new Promise<Blob | null>((resolve) => (card ? card.toBlob(resolve, "image/webp", 0.8) : resolve(null)));
  if (data) {
    await bytes(`/characters/${owner.id}/picture`, { method: "PUT", body: data });
  }
}

/** Whether springs swing in the page: where there are chains, and one take alone is shown. */
const lively = (): boolean => doc.value.live && Boolean(character.value?.chains?.length) && !comparing.value;

function paint(): void {
  const owner = character.value;
  const mask = painting.value && worn.value?.owner === owner?.id ? worn.value?.worn : null;
  const seen = owner && (correcting.value || colouring.value === "parts") ? tintOf(owner) : null;
  const tint: Tint | null = mask ? { rows: mask.rows, of: (vertex) => (mask.mask[vertex] ? WORN : BARE) } : seen;
  for (const pane of new Set(viewer?.panes.map((each) => each.model) ?? [])) {
    colour(pane, colouring.value, weightOf.value, tint);
    if (pane.springs) {
      Object.assign(pane.springs, { stiffness: doc.value.stiffness, gravity: doc.value.gravity });
    }
  }
  viewer?.touch();
}

export function Stage({ children }: { children?: preact.ComponentChildren }) {
  const place = useRef<HTMLDivElement>(null);
  useEffect(() => {
    const here = place.current;
    if (!here) {
      return undefined;
    }
    const view = new Viewer(here);
    viewer = view;
    view.dragged = (part, position) => {
      const at = Math.round(time.value * 100) / 100;
      const rest = doc.value.pins.filter((pin) => !(pin.part === part && Math.abs(pin.time - at) < 0.05));
      change("pin", { pins: [...rest, { part, time: at, position, hold: 0 }].sort((a, b) => a.time - b.time) });
      void bend();
    };
    view.painted = () => void lift();
    view.drew = (path) => {
      drawing.value = false;
      change("draw a path", { path });
    };
    view.chosen = (pane) => {
      const label = view.panes[pane]?.label;
      if (label) {
        choose(label);
      }
    };
    let seen = "";
    const stops = [
      effect(() => {
        void [living.value, correcting.value, about.value, character.value, take.value, comparing.value, takes.value, characters.value, doc.value.live, painting.value];
        void refresh();
      }),
      effect(() => {
        void [colouring.value, weightOf.value, correcting.value, numbered.value, touched.value, picked.value, character.value, painting.value, worn.value, doc.value.stiffness, doc.value.gravity];
        paint();
      }),
      effect(() => {
        const owner = character.value;
        const one = take.value;
        const shownModel = view.panes[0]?.model;
        const before = seen;
        view.marks = {
          skeleton: colouring.value === "skeleton" && owner ? skeletonOf(owner, one?.skin ?? "handles", shownModel?.bones ?? []) : [],
          chains: colouring.value === "chains" && owner && one?.skin !== "bones" ? strandsOf(owner, shownModel?.bones.length ?? 0) : [],
          joints: correcting.value && owner ? jointsOf(owner) : [],
          piece: correcting.value ? (touched.value?.at ?? null) : null,
          ends: owner?.ends ?? [],
          pins: doc.value.pins,
          path: living.value || correcting.value ? [] : doc.value.path,
          handles:
            !["handles", "weights"].includes(colouring.value) || !owner?.positions || one?.skin === "bones"
              ? []
              : (owner.used ?? []).map((joint) => ({
                  joint,
                  place: owner.positions?.[joint] ?? [0, 0, 0],
                  colour: handleColour(joint),
                })),
        };
        view.live = lively();
        view.paint = painting.value ? (ray) => Boolean(view.panes[0] && touch(view.panes[0].model, ray, view.extent)) : null;
        view.told = living.value ? (look, reach) => stream?.point(look, reach) : null;
        view.pick = correcting.value ? (ray, left, top) => view.panes[0] && pick(view.panes[0].model, ray, left, top) : null;
        view.placed = correcting.value ? (name, point) => void moveJoint(name, point) : null;
        view.directing = !living.value && !correcting.value && !painting.value && !playing.value && one?.state === "done" && one.skin !== "bones" && !comparing.value;
        view.drawing = drawing.value;
        view.follow = follow.value;
        seen = JSON.stringify([view.marks, view.directing, view.drawing, view.follow]);
        if (seen !== before) {
          view.touch(); // a record that changed is no reason to draw
        }
      }),
      effect(() => {
        void living.value; // what lives has a time of its own
        view.time = time.value;
        view.touch();
      }),
    ];
    let frame = 0;
    let before = performance.now();
    let pace = 0; // [s] between frames, over the last ten or so
    let drawn = 0;
    const tick = (now: number): void => {
      frame = requestAnimationFrame(tick);
      pace += ((now - before) / 1000 - pace) / 10;
      const passed = Math.min((now - before) / 1000, 0.25);
      before = now;
      if (document.hidden) {
        return;
      }
      if (pace > SLOW && running.value.length && playing.value && !stream && now - drawn < REST) {
        return; // a browser that draws with the processor leaves it to what is being made
      }
      drawn = now;
      const length = seconds();
      if (stream) {
        stream.step(view, passed);
        view.touch();
      } else if (playing.value && length > 0) {
        time.value = (time.value + passed * speed.value) % length;
      }
      view.pass(passed);
      view.draw();
    };
    frame = requestAnimationFrame(tick);
    return () => {
      cancelAnimationFrame(frame);
      stops.forEach((stop) => stop());
    };
  }, []);
  return (
    <div class="stage" ref={place}>
      {children}
      <Picked say={sayKind} />
      <Labels />
    </div>
  );
}

function Labels() {
  const several = comparing.value ? compared() : [];
  const now = take.value;
  const waiting = now && (now.state === "waiting" || now.state === "draft") ? now : null;
  const job = waiting && running.value.find((one) => one.about.takes?.includes(waiting.id));
  return (
    <>
      {several.length > 1 && (
        <div class={`labels grid-${several.length > 3 ? 2 : several.length}`} aria-hidden="true">
          {several.map((one) => (
            <span key={one.id} class={one.id === doc.value.take ? "chosen" : ""}>
              variation {one.seed} {one.star ? "· starred" : ""} {one.state === "draft" ? "· draft" : ""}
            </span>
          ))}
        </div>
      )}
      {waiting && several.length < 2 && (
        <p class="badge" role="status">
          {waiting.state === "draft" ? "draft · the full take is coming" : "making"}
          {warm.value ? "" : " · the networks are being loaded, once"}
          {job ? ` · ${Math.round(job.done * 100)} %` : ""}
        </p>
      )}
    </>
  );
}
