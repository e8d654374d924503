// The sentence: typed, underlined where it is not understood, made into takes.

import { signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { generate, playClip, regenerate } from "./actions";
import { send } from "./api";
import { clipOf, knowClips } from "./library";
import { begin } from "./live";
import { MOST_LETTERS } from "./schema";
import { fromFile, inRange, lasting, tooLong } from "./script";
import { attempt, change, changing, character, doc, instead, pause, say, take } from "./state";
import type { Understanding } from "./types";

const understanding = signal<{ text: string; found: Understanding } | null>(null);

let timer = 0;
function look(text: string): void {
  clearTimeout(timer);
  if (!text.trim() || text.length > MOST_LETTERS) {
    understanding.value = null;
    return;
  }
  timer = window.setTimeout(async () => {
    try {
      understanding.value = { text, found: await send<Understanding>("POST", "/understand", { text }) };
    } catch {
      understanding.value = null;
    }
  }, 180);
}

function Backdrop({ text }: { text: string }) {
  const known = understanding.value;
  if (!known || known.text !== text) {
    return <div class="backdrop">{text}</div>;
  }
  const parts: preact.ComponentChildren[] = [];
  let at = 0;
  for (const one of known.found.unknown) {
    parts.push(text.slice(at, one.start), <u key={one.start}>{text.slice(one.start, one.stop)}</u>);
    at = one.stop;
  }
  return (
    <div class="backdrop">
      {parts}
      {text.slice(at)}
    </div>
  );
}

function sentence(text: string): void {
  const { script, sentence: number } = doc.value;
  change("type", { script: script.map((part, place) => (place === number ? { text, seconds: part.seconds, ...(part.fits && { fits: true }) } : part)) });
}

async function suggest(name: string): Promise<void> {
  await attempt(knowClips);
  const clip = clipOf(name);
  if (clip) {
    await playClip(clip);
  }
}

export function Prompt() {
  const box = useRef<HTMLInputElement>(null);
  const now = doc.value;
  const part = now.script[now.sentence] ?? now.script[0];
  const text = changing.value ? instead.value : (part?.text ?? "");
  useEffect(() => look(text), [text]);
  const takes = understanding.value?.text === part?.text ? understanding.value?.found.seconds : undefined;
  useEffect(() => {
    if (takes && part?.fits && takes !== part.seconds) {
      const script = now.script.map((one, place) => (place === now.sentence ? { ...one, seconds: inRange(takes) } : one));
      change("", { script });
    }
  }, [takes, part?.fits]);
  const known = understanding.value?.text === text ? understanding.value.found : null;
  const ready = character.value?.state === "ready";
  const go = (): void => {
    if (!ready) {
      say(character.value ? "the character is still being opened" : "drop a character first, or choose a sample", true);
    } else if (changing.value) {
      void regenerate(text);
    } else {
      void generate();
    }
  };
  const live = (): void => {
    if (character.value) {
      begin(character.value);
    }
  };
  const kept = now.span || now.keep.length || now.poses.length;
  return (
    <form
      class="prompt"
      noValidate
      onSubmit={(event) => {
        event.preventDefault();
        go();
      }}
    >
      <div class="sentence">
        <Backdrop text={text} />
        <input
          ref={box}
          id="sentence"
          value={text}
          autocomplete="off"
          spellcheck={false}
          aria-label={changing.value ? "what is done instead" : "what the character does"}
          aria-describedby="understood"
          placeholder={
            fromFile(take.value, now)
              ? `${take.value.script[0]?.text}: type what is done instead of it`
              : "walks forward, then waves with the left hand"
          }
          onInput={(event) =>
            changing.value ? (instead.value = event.currentTarget.value) : sentence(event.currentTarget.value)
          }
        />
      </div>
      <button class="main" disabled={!ready || (changing.value && !kept)} id="animate">
        {changing.value ? "Make it anew" : "Animate"}
      </button>
      <button type="button" class="second" id="go-live" disabled={!ready} title="it never stops: type what is done next, steer it, point" onClick={live}>
        Live
      </button>
      <p id="understood" class="understood" role="status">
        {text.length > MOST_LETTERS && <b>{tooLong(text)}. </b>}
        {known && !known.ok && <b>No movement is understood. </b>}
        {known?.unknown.length ? `not understood: ${known.unknown.map((one) => one.word).join(", ")}. ` : ""}
        {known && known.english !== text && known.language !== "" ? `read as: ${known.english}. ` : ""}
        {known && (known.unknown.length > 0 || !known.ok) && known.nearest.length > 0 && (
          <>
            try:{" "}
            {known.nearest.map((one) => (
              <button
                type="button"
                class="chip"
                key={one}
                onClick={() => {
                  pause();
                  if (changing.value) instead.value = one;
                  else sentence(one);
                }}
              >
                {one}
              </button>
            ))}
          </>
        )}
        {!changing.value && !part?.clip && known && known.clips.length > 0 && (
          <>
            clips:{" "}
            {known.clips.slice(0, 4).map((name) => (
              <button type="button" class="chip" key={name} title="play this clip of the library" onClick={() => void suggest(name)}>
                ▶ {name.replaceAll("-", " ")}
              </button>
            ))}
          </>
        )}
        {changing.value && !kept && "Select a stretch of time, keep parts of the body, or pin a pose. "}
      </p>
      <div class="how">
        {!changing.value && (
          <label class="field small">
            <span>lasts</span>
            <input
              type="number"
              min={0.5}
              max={120}
              step={0.5}
              value={part?.fits ? "" : part?.seconds}
              placeholder="what fits"
              title="empty: as long as what is done takes"
              aria-label="seconds of this sentence"
              onInput={(event) => {
                const length = event.currentTarget.value === "" && !part?.clip ? null : Number(event.currentTarget.value);
                if (length === null || (length >= 0.5 && length <= 120)) {
                  change("length", { script: lasting(now.script, now.sentence, length) });
                }
              }}
            />
            <span>seconds</span>
          </label>
        )}
        <div class="choice" role="group" aria-label="how many takes">
          {([1, 4] as const).map((count) => (
            <button type="button" key={count} aria-pressed={now.count === count} onClick={() => change("", { count })}>
              {count === 1 ? "one take" : "four takes"}
            </button>
          ))}
        </div>
        <label class="field small" title="the same number gives the same motion">
          <span>variation</span>
          <input
            type="number"
            min={0}
            step={1}
            value={now.seed}
            aria-label="variation: the same number gives the same motion"
            onInput={(event) => change("seed", { seed: Math.max(0, Math.round(Number(event.currentTarget.value)) || 0) })}
          />
        </label>
        <button type="button" class="link" onClick={() => change("", { seed: Math.floor(Math.random() * 100000) })}>
          another variation
        </button>
        {take.value?.state === "done" && take.value.skin === "handles" && (
          <label class="toggle" title="what is kept or lies outside of the stretch stays; the rest is made anew">
            <input type="checkbox" checked={changing.value} onChange={(event) => (changing.value = event.currentTarget.checked)} />
            change a part of this take
          </label>
        )}
      </div>
    </form>
  );
}
