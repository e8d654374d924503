// Export: which takes, as what, at what rate, each its own file or all as the clips of one.

import { signal } from "@preact/signals";
import { useLayoutEffect, useRef, useState } from "preact/hooks";
import { download, saveProject } from "./actions";
import { beside } from "./modal";
import { compared } from "./stage";
import { about, character, comparing, ownTakes, take } from "./state";
import { titleOf, whichOf } from "./takes";

export const exporting = signal(false);

const FORMATS: Record<string, string> = {
  glb: "GLB — Godot, three.js, Blender, the web",
  fbx: "FBX — Unity, Unreal, Maya",
  bvh: "BVH — the skeleton's motion",
  vrma: "VRMA — VRM avatars",
  vmd: "VMD — MikuMikuDance",
  usdz: "USDZ — USD, AR",
  npz: "NPZ — the handle motion",
  mp4: "MP4 — a video, 1280 x 720",
  gif: "GIF — a small video, 480 x 360",
};
const OWN: Record<string, string> = {
  bunraku: ".bunraku — the character with all its takes, to be opened here again",
};
/** Formats that hold several takes, and how. */
const TOGETHER: Record<string, string> = {
  glb: "one file, each take a clip of it",
  mp4: "one video, the takes side by side",
  gif: "one picture, the takes side by side",
};

export function Export() {
  return exporting.value ? <ExportDialog /> : null;
}

function ExportDialog() {
  const box = useRef<HTMLDialogElement>(null);
  const [choice, setChoice] = useState("glb");
  const [fps, setFps] = useState(30);
  const [together, setTogether] = useState(true);
  const [chosen, setChosen] = useState<string[]>(comparing.value ? compared().map((one) => one.id) : take.value ? [take.value.id] : []);
  useLayoutEffect(() => {
    box.current?.showModal(); // at once: a key that comes right after the click is the dialog's
  }, []);
  const done = ownTakes.value.filter((one) => one.state === "done");
  const some = done.filter((one) => chosen.includes(one.id));
  const written = (about.value?.writes ?? []).filter((one) => one !== "vmd" || character.value?.mmd);
  const presets = about.value?.presets ?? [];
  const preset = presets.find((one) => `for ${one.name}` === choice);
  const format = preset ? preset.suffix.slice(1) : choice;
  const ours = choice in OWN;
  const choose = (value: string): void => {
    setChoice(value);
    setFps(presets.find((one) => `for ${one.name}` === value)?.fps ?? 30);
  };
  const [low, high] = about.value?.fps ?? [1, 240];
  const close = (): void => box.current?.close(); // which gives the focus back; taking it off the page would not
  const go = (): void => {
    close();
    if (format === "bunraku") {
      void saveProject();
    } else {
      const all = { format, fps, together: together && format in TOGETHER };
      void download(some, preset ? { ...all, preset: preset.name } : all);
    }
  };
  return (
    <dialog ref={box} class="export" aria-labelledby="export-title" onClose={() => (exporting.value = false)} onMouseDown={beside}>
      <form
        method="dialog"
        onSubmit={(event) => {
          event.preventDefault();
          go();
        }}
      >
        <h2 id="export-title">Export</h2>
        <label class="field">
          <span>format</span>
          <select id="format" value={choice} onChange={(event) => choose(event.currentTarget.value)}>
            {presets.length > 0 && (
              <optgroup label="for a program">
                {presets.map((one) => (
                  <option key={one.name} value={`for ${one.name}`}>
                    {one.title}
                  </option>
                ))}
              </optgroup>
            )}
            <optgroup label="a format">
              {written.map((one) => (
                <option key={one} value={one}>
                  {FORMATS[one] ?? one.toUpperCase()}
                </option>
              ))}
            </optgroup>
            <optgroup label="of this page">
              {Object.entries(OWN).map(([one, title]) => (
                <option key={one} value={one}>
                  {title}
                </option>
              ))}
            </optgroup>
          </select>
        </label>
        {preset && <p class="hint">{preset.note}</p>}
        {!ours && (
          <>
            <fieldset>
              <legend>takes</legend>
              <ul class="list some">
                {done.map((one) => (
                  <li key={one.id}>
                    <label class="toggle">
                      <input
                        type="checkbox"
                        checked={chosen.includes(one.id)}
                        onChange={(event) => setChosen(event.currentTarget.checked ? [...chosen, one.id] : chosen.filter((id) => id !== one.id))}
                      />
                      <span>
                        {titleOf(one)} <small>{whichOf(one)}</small>
                      </span>
                    </label>
                  </li>
                ))}
              </ul>
              <button type="button" class="link" onClick={() => setChosen(some.length === done.length ? [] : done.map((one) => one.id))}>
                {some.length === done.length ? "none" : "all"}
              </button>
            </fieldset>
            {some.length > 1 && !preset && format in TOGETHER && (
              <label class="toggle">
                <input type="checkbox" checked={together} onChange={(event) => setTogether(event.currentTarget.checked)} />
                {TOGETHER[format]}
              </label>
            )}
            {!["npz", "vmd"].includes(format) && (
              <label class="field small">
                <span>frames a second</span>
                <input
                  id="fps"
                  type="number"
                  min={low}
                  max={high}
                  value={fps}
                  onChange={(event) => setFps(Math.min(Math.max(Number(event.currentTarget.value) || 30, low), high))}
                />
              </label>
            )}
          </>
        )}
        <p class="buttons">
          <button class="main" id="write" disabled={!ours && !some.length}>
            {ours || some.length < 2 ? "Export" : `Export ${some.length} takes`}
          </button>
          <button type="button" onClick={close}>
            Cancel
          </button>
        </p>
      </form>
    </dialog>
  );
}
