// The blind study: three clips in step under one camera and one slider, ranked by choosing places.

import { signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { AnimationMixer, Box3, type AnimationClip, type Object3D } from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { bytes, get, send } from "./api";
import { loadModel, type Model } from "./model";
import { attempt, playing, time } from "./state";
import { Viewer } from "./viewer";
import type { Clip } from "./clip";

interface Next {
  participant: string;
  done: number;
  total: number;
  trial?: { id: string; prompt: string; clips: string[] };
  questions?: Record<string, string>;
}

const KEY = "bunraku-participant";
const next = signal<Next | null>(null);
const ranks = signal<Record<string, Record<string, number>>>({});
let began = 0;
let view: Viewer | null = null;

/** A clip of a GLB, in the form of the studio's own clips: joints and their tracks, sampled 20 times a second. */
function sampled(root: Object3D, animation: AnimationClip, model: Model): Clip {
  const fps = 20;
  const frames = Math.max(Math.round(animation.duration * fps) + 1, 2);
  const joints = model.bones.length;
  const clip: Clip = {
    fps, frames, joints, root: 0, apparel: null, seconds: (frames - 1) / fps,
    translations: new Float32Array(frames * joints * 3),
    rotations: new Float32Array(frames * joints * 4),
  };
  const mixer = new AnimationMixer(root);
  mixer.clipAction(animation).play();
  for (let frame = 0; frame < frames; frame += 1) {
    mixer.setTime(Math.min(frame / fps, animation.duration - 1e-4));
    model.bones.forEach((bone, joint) => {
      bone.position.toArray(clip.translations, (frame * joints + joint) * 3);
      bone.quaternion.toArray(clip.rotations, (frame * joints + joint) * 4);
    });
  }
  mixer.stopAllAction();
  return clip;
}

async function show(found: Next): Promise<void> {
  next.value = found;
  ranks.value = {};
  began = performance.now();
  time.value = 0;
  localStorage.setItem(KEY, found.participant);
  const place = view;
  if (!place || !found.trial) {
    return;
  }
  const panes = [];
  for (const name of found.trial.clips) {
    const data = await bytes(`/study/clips/${name}`);
    const model = await loadModel(name, data.slice(0));
    const { animations } = await new GLTFLoader().parseAsync(data, "");
    const animation = animations[0];
    panes.push({ model, clip: animation ? sampled(model.group, animation, model) : null, label: name });
  }
  const first = panes[0];
  place.show(panes);
  if (first) {
    const box = new Box3().setFromObject(first.model.group);
    place.frame([box.min.toArray(), box.max.toArray()]);
  }
}

function begin(): Promise<unknown> {
  return attempt(async () => {
    const before = localStorage.getItem(KEY) ?? "";
    let found: Next;
    try {
      found = await get<Next>(`/study?participant=${before}`);
    } catch {
      found = await get<Next>("/study");
    }
    await show(found);
  });
}

export function Study() {
  const place = useRef<HTMLDivElement>(null);
  useEffect(() => {
    if (!place.current) {
      return undefined;
    }
    const made = new Viewer(place.current);
    view = made;
    let before = performance.now();
    let frame = 0;
    const tick = (now: number): void => {
      frame = requestAnimationFrame(tick);
      const length = Math.max(0.1, ...made.panes.map((pane) => pane.clip?.seconds ?? 0));
      if (playing.value && !document.hidden) {
        time.value = (time.value + Math.min((now - before) / 1000, 0.25)) % length;
      }
      before = now;
      made.time = time.value;
      made.touch();
      made.draw();
    };
    frame = requestAnimationFrame(tick);
    void begin();
    return () => cancelAnimationFrame(frame);
  }, []);
  const now = next.value;
  const clips = now?.trial?.clips ?? [];
  const whole =
    now?.trial &&
    Object.keys(now.questions ?? {}).every(
      (question) => new Set(Object.values(ranks.value[question] ?? {})).size === clips.length,
    );
  const rank = (question: string, clip: string, value: number): void => {
    const own = Object.fromEntries(Object.entries(ranks.value[question] ?? {}).filter(([, each]) => each !== value));
    ranks.value = { ...ranks.value, [question]: { ...own, [clip]: value } };
  };
  return (
    <div class="study">
      <div class="study-head">
        {now?.trial ? (
          <h1>“{now.trial.prompt}”</h1>
        ) : (
          <h1>{now ? "Thank you: that was all." : "One moment…"}</h1>
        )}
        <p class="muted">
          {now ? `${now.done} of ${now.total} · ` : ""}three motions of one sentence, in step. Drag to look around, and rank
          them from 1, the best, to 3.
        </p>
      </div>
      <div class="stage" ref={place}>
        <div class="labels grid-3" aria-hidden="true">
          {clips.map((clip, number) => (
            <span key={clip}>{"ABCDEF"[number]}</span>
          ))}
        </div>
      </div>
      {now?.trial && (
        <form
          class="study-foot"
          onSubmit={(event) => {
            event.preventDefault();
            void attempt(async () =>
              show(
                await send<Next>("POST", "/study/answers", {
                  participant: now.participant,
                  trial: now.trial?.id,
                  ranks: ranks.value,
                  seconds: (performance.now() - began) / 1000,
                }),
              ),
            );
          }}
        >
          <div class="transport">
            <button type="button" class="icon" aria-label={playing.value ? "pause" : "play"} onClick={() => (playing.value = !playing.value)}>
              {playing.value ? "❚❚" : "▶"}
            </button>
            <input
              type="range"
              aria-label="time"
              min={0}
              max={Math.max(0.1, ...(view?.panes ?? []).map((pane) => pane.clip?.seconds ?? 0))}
              step={0.05}
              value={time.value}
              onInput={(event) => {
                playing.value = false;
                time.value = Number(event.currentTarget.value);
              }}
            />
          </div>
          <div class="ranks">
            {Object.entries(now.questions ?? {}).map(([question, text]) => (
              <fieldset key={question}>
                <legend class="muted">{text}</legend>
                <span class="muted">{question}</span>
                {clips.map((clip, number) => (
                  <div class="choice" role="group" aria-label={`rank of ${"ABCDEF"[number]}, ${question}`} key={clip}>
                    <span>{"ABCDEF"[number]}</span>
                    {clips.map((_, place) => (
                      <button
                        type="button"
                        key={place}
                        aria-pressed={ranks.value[question]?.[clip] === place + 1}
                        onClick={() => rank(question, clip, place + 1)}
                      >
                        {place + 1}
                      </button>
                    ))}
                  </div>
                ))}
              </fieldset>
            ))}
          </div>
          <button class="main" disabled={!whole} id="answer">
            Next
          </button>
        </form>
      )}
    </div>
  );
}
