// The bar of a character that never stops: what it does next, what keys play, and the end.

import { signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { settle, type Made } from "./actions";
import { send } from "./api";
import { finish, keys, living, putKeys, stream } from "./live";
import { MOST_LETTERS } from "./schema";
import { attempt, ended } from "./state";

const text = signal("");
/** Which key's sentence is being changed. */
const editing = signal<"walk" | "run" | number | null>(null);

/** End it, and keep what was played as a take. */
export async function endLive(): Promise<void> {
  const before = finish();
  if (before?.session) {
    await attempt(async () => {
      const body = { session: before.session, stop: before.stopAt, text: before.said.join("; ").slice(0, MOST_LETTERS) || "live" };
      const made = await send<Made>("POST", `/characters/${before.owner.id}/live/take`, body);
      settle("play live", made, [{ text: "", seconds: 4 }]);
      await ended(made.job);
    });
  }
}

/** The keys of a character that lives; whether one was taken. */
export function liveKey(event: KeyboardEvent, down: boolean): boolean {
  const target = event.target as HTMLElement;
  const typing = target.matches("input") && (!event.key.startsWith("Arrow") || Boolean((target as HTMLInputElement).value));
  if (!stream || event.ctrlKey || event.metaKey || event.altKey || (typing && event.key !== "Shift" && down)) {
    return false;
  }
  const taken = (down && event.repeat) || stream.key(event.key, down); // a key that is held says nothing more
  if (taken) {
    event.preventDefault();
  }
  return taken;
}

function Key({ name, which, sentence }: { name: string; which: "walk" | "run" | number; sentence: string }) {
  const put = (value: string): void => {
    editing.value = null;
    const now = keys.value;
    const words = value.trim();
    if (typeof which === "number") {
      putKeys({ ...now, numbers: words ? now.numbers.map((old, each) => (each === which ? words : old)) : now.numbers.filter((_, each) => each !== which) });
    } else if (words) {
      putKeys({ ...now, [which]: words });
    }
  };
  return editing.value === which ? (
    <input
      class="keyed"
      autofocus
      defaultValue={sentence}
      maxLength={200}
      aria-label={`what ${name} plays`}
      ref={(here) => here?.focus()}
      onBlur={(event) => put(event.currentTarget.value)}
      onKeyDown={(event) => {
        if (event.key === "Enter") {
          event.preventDefault();
          event.currentTarget.blur();
        }
      }}
    />
  ) : (
    <span class="chip keyed">
      <button type="button" class="play-key" title="play it" disabled={typeof which !== "number"} onClick={() => stream?.say(sentence)}>
        <kbd>{name}</kbd> {sentence}
      </button>
      <button type="button" class="link" aria-label={`change what ${name} plays`} onClick={() => (editing.value = which)}>
        change
      </button>
    </span>
  );
}

/** What steers it where there are no keys; held as a key is. */
function Pad() {
  return (
    <div class="pad" role="group" aria-label="steer it">
      {["Left", "Up", "Down", "Right"].map((way) => (
        <button
          type="button"
          class="second"
          key={way}
          onPointerDown={() => stream?.key(`Arrow${way}`, true)}
          onPointerUp={() => stream?.key(`Arrow${way}`, false)}
          onPointerLeave={() => stream?.key(`Arrow${way}`, false)}
        >
          {{ Left: "left", Up: "ahead", Down: "back", Right: "right" }[way]}
        </button>
      ))}
    </div>
  );
}

export function LiveBar() {
  const box = useRef<HTMLInputElement>(null);
  useEffect(() => {
    const up = (event: KeyboardEvent): void => void liveKey(event, false);
    const away = (): void => stream?.release();
    addEventListener("keyup", up);
    addEventListener("blur", away);
    box.current?.focus();
    return () => {
      removeEventListener("keyup", up);
      removeEventListener("blur", away);
    };
  }, []);
  const now = keys.value;
  return (
    <form
      class="prompt lively"
      noValidate
      onSubmit={(event) => {
        event.preventDefault();
        if (text.value.trim()) {
          stream?.say(text.value.trim());
          text.value = "";
        }
      }}
    >
      <div class="sentence">
        <input
          ref={box}
          id="sentence"
          value={text.value}
          maxLength={MOST_LETTERS}
          autocomplete="off"
          spellcheck={false}
          aria-label="what the character does next"
          placeholder="type what it does next, and press Enter"
          onInput={(event) => (text.value = event.currentTarget.value)}
        />
      </div>
      <button class="main" id="do-next">
        Do it
      </button>
      <button type="button" class="second" id="live-end" title="end it; what was played, at most the last minute, becomes a take" onClick={() => void endLive()}>
        End and keep
      </button>
      <p class="understood" role="status">
        <b>Now: {living.value?.said}.</b>
        <span>Arrow keys steer it. It looks at the mouse; hold the button, and it reaches.</span>
      </p>
      <Pad />
      <div class="how keys">
        <Key name="arrows" which="walk" sentence={now.walk} />
        <Key name="Shift" which="run" sentence={now.run} />
        {now.numbers.map((sentence, number) => (
          <Key key={number} name={String(number + 1)} which={number} sentence={sentence} />
        ))}
        {now.numbers.length < 9 && (
          <button
            type="button"
            class="link"
            onClick={() => {
              putKeys({ ...now, numbers: [...now.numbers, text.value.trim() || "waves"] });
              editing.value = text.value.trim() ? null : now.numbers.length;
            }}
          >
            put a sentence on key {now.numbers.length + 1}
          </button>
        )}
      </div>
    </form>
  );
}
