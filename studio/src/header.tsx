// The bar at the top: undo, export, jobs, light and dark, keys.

import { signal } from "@preact/signals";
import { useRef } from "preact/hooks";
import { openAll } from "./drop";
import { exporting } from "./export";
import { Modal } from "./modal";
import { about, canRedo, canUndo, online, redo, running, take, undo } from "./state";

type Theme = "light" | "dark";
const system = matchMedia("(prefers-color-scheme: dark)");
const stored = localStorage.getItem("bunraku-theme") as Theme | null;
export const theme = signal<Theme>(stored ?? (system.matches ? "dark" : "light"));
export const help = signal(false);
export function Header() {
  const one = take.value;
  const ready = one?.state === "done";
  const files = useRef<HTMLInputElement>(null);
  return (
    <header class="top">
      <h1>
        Bunraku <span>studio</span>
      </h1>
      <button id="open" onClick={() => files.current?.click()}>
        Open a file
      </button>
      <input
        ref={files}
        type="file"
        multiple
        hidden
        id="open-files"
        onChange={(event) => {
          const found = new Map([...(event.currentTarget.files ?? [])].map((file) => [file.name, file]));
          event.currentTarget.value = "";
          if (found.size) {
            void openAll(found);
          }
        }}
      />
      <button class="quiet" aria-label="undo" title={canUndo.value ? `undo: ${canUndo.value} (Ctrl Z)` : "undo"} disabled={canUndo.value === null} onClick={() => void undo()}>
        Undo
      </button>
      <button class="quiet" aria-label="redo" title={canRedo.value ? `redo: ${canRedo.value} (Ctrl Shift Z)` : "redo"} disabled={canRedo.value === null} onClick={() => void redo()}>
        Redo
      </button>
      <span class="fill" />
      {running.value.length > 0 && (
        <span class="muted" role="status">
          making {running.value.length > 1 ? `${running.value.length} things` : "it"}
        </span>
      )}
      {!online.value && <span class="bad">not connected</span>}
      <button id="export" class="main" aria-haspopup="dialog" disabled={!ready} onClick={() => (exporting.value = true)}>
        Export
      </button>
      <button
        class="quiet"
        id="theme"
        onClick={() => {
          theme.value = theme.value === "dark" ? "light" : "dark";
          localStorage.setItem("bunraku-theme", theme.value);
        }}
      >
        {theme.value === "dark" ? "Light" : "Dark"}
      </button>
      <button class="quiet" aria-label="keys" title="?" aria-expanded={help.value} onClick={() => (help.value = !help.value)}>
        Keys
      </button>
    </header>
  );
}

const KEYS: [string, string][] = [
  ["Space", "play, pause"],
  ["← →", "a frame back, on"],
  ["Shift with ← → ↑ ↓", "turn the camera"],
  ["+ −", "nearer, farther"],
  ["Enter in the sentence", "animate"],
  ["/", "to the sentence"],
  ["1 … 4", "take by place in the list"],
  ["C", "takes side by side"],
  ["I", "pin this pose"],
  ["P", "draw a path on the floor"],
  ["F", "follow the character"],
  ["K", "shake the character, where its springs are live"],
  ["X", "touch the middle of the view with the brush"],
  ["S", "star the take"],
  ["Arrows, Shift, 1 … 9 in Live", "walk, run, play a sentence"],
  ["Ctrl Z, Ctrl Shift Z", "undo, redo"],
];

export function Help() {
  return help.value ? (
    <Modal label="keys" close={() => (help.value = false)}>
      <h2>Keys</h2>
      <dl>
        {KEYS.map(([key, what]) => (
          <div key={key}>
            <dt>{key}</dt>
            <dd>{what}</dd>
          </div>
        ))}
      </dl>
      <p class="hint">
        Bunraku {about.value?.version}. Nothing leaves this machine. <a href="LICENSES.txt">Licences of the page</a>
      </p>
      <button>Close</button>
    </Modal>
  ) : null;
}
