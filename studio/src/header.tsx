// The bar at the top: undo, export, jobs, light and dark, keys.

import { signal } from "@preact/signals";
import { download, hand, saveProject } from "./actions";
import { Menu } from "./menu";
import { filming, holder, seconds, viewer } from "./stage";
import { about, attempt, canRedo, canUndo, character, online, playing, redo, running, say, take, time, undo } from "./state";

type Theme = "light" | "dark";
const system = matchMedia("(prefers-color-scheme: dark)");
const stored = localStorage.getItem("bunraku-theme") as Theme | null;
export const theme = signal<Theme>(stored ?? (system.matches ? "dark" : "light"));
export const help = signal(false);
const film = signal<{ done: number; name: string } | null>(null);
let stop = false;

const FORMATS: Record<string, string> = {
  glb: "GLB — engines, web, Blender",
  fbx: "FBX — Unity, Unreal, Maya",
  bvh: "BVH — the skeleton's motion",
  vrma: "VRMA — VRM avatars",
  vmd: "VMD — MikuMikuDance",
  usdz: "USDZ — USD, AR",
  npz: "NPZ — the handle motion",
};

async function shoot(kind: "mp4" | "gif"): Promise<void> {
  const view = viewer;
  const one = take.value;
  const place = holder;
  if (!view || !one || !place || film.value) {
    return;
  }
  await attempt(async () => {
    const video = await import("./video");
    const before = { playing: playing.value, time: time.value };
    playing.value = false;
    filming.on = true;
    stop = false;
    film.value = { done: 0, name: kind };
    try {
      const shot = {
        viewer: view,
        seconds: seconds(),
        told: (done: number) => void (film.value = { done, name: kind }),
        stopped: () => stop,
      };
      const made =
        kind === "mp4" ? await video.mp4(shot, 1280, 720, 30) : await video.gif(shot, 480, 360, 15);
      hand(made, `${character.value?.name ?? "take"}.${kind}`);
      say(`${kind.toUpperCase()}: ${(made.size / 1e6).toFixed(1)} MB`);
    } finally {
      filming.on = false;
      film.value = null;
      view.restore(place);
      playing.value = before.playing;
      time.value = before.time;
    }
  });
}

export function Header() {
  const one = take.value;
  const ready = one?.state === "done";
  return (
    <header class="top">
      <h1>
        Bunraku <span>studio</span>
      </h1>
      <button class="icon" aria-label="undo" title={canUndo.value ? `undo: ${canUndo.value} (Ctrl Z)` : "undo"} disabled={canUndo.value === null} onClick={() => void undo()}>
        ↶
      </button>
      <button class="icon" aria-label="redo" title={canRedo.value ? `redo: ${canRedo.value} (Ctrl Shift Z)` : "redo"} disabled={canRedo.value === null} onClick={() => void redo()}>
        ↷
      </button>
      <span class="fill" />
      {film.value && (
        <span role="status">
          {film.value.name} <progress max={1} value={film.value.done} />{" "}
          <button class="link" onClick={() => (stop = true)}>
            stop
          </button>
        </span>
      )}
      {running.value.length > 0 && (
        <span class="muted" role="status">
          {running.value.length} {running.value.length > 1 ? "jobs" : "job"}
        </span>
      )}
      {!online.value && <span class="bad">not connected</span>}
      <Menu id="export" label="Export ▾" disabled={!ready}>
        {one && (
          <>
            {about.value?.writes
              .filter((format) => format !== "vmd" || character.value?.mmd)
              .map((format) => (
                <button role="menuitem" key={format} onClick={() => void download(one, format)}>
                  {FORMATS[format] ?? format.toUpperCase()}
                </button>
              ))}
            <button role="menuitem" onClick={() => void shoot("mp4")}>
              MP4 — a video of the view
            </button>
            <button role="menuitem" onClick={() => void shoot("gif")}>
              GIF — a small loop
            </button>
            <button role="menuitem" onClick={() => void saveProject()}>
              .bunraku — character and takes as one project file
            </button>
          </>
        )}
      </Menu>
      <button
        class="icon"
        aria-label={theme.value === "dark" ? "light colours" : "dark colours"}
        title="light or dark"
        onClick={() => {
          theme.value = theme.value === "dark" ? "light" : "dark";
          localStorage.setItem("bunraku-theme", theme.value);
        }}
      >
        ◐
      </button>
      <button class="icon" aria-label="keys" title="?" aria-expanded={help.value} onClick={() => (help.value = !help.value)}>
        ?
      </button>
    </header>
  );
}

const KEYS: [string, string][] = [
  ["Space", "play, pause"],
  ["← →", "a frame back, on"],
  ["Enter in the sentence", "animate"],
  ["/", "to the sentence"],
  ["1 … 4", "take by place in the list"],
  ["C", "takes side by side"],
  ["I", "pin this pose"],
  ["P", "draw a path on the floor"],
  ["F", "follow the character"],
  ["S", "star the take"],
  ["Ctrl Z, Ctrl Shift Z", "undo, redo"],
];

export function Help() {
  return help.value ? (
    <dialog open class="help" aria-label="keys">
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
      <button onClick={() => (help.value = false)}>Close</button>
    </dialog>
  ) : null;
}
