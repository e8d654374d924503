// For tests, in a build of their own: the state, and the view at a time of their choosing.

import { Color, MeshBasicMaterial, Vector3 } from "three";
import { stream } from "./live";
import { pose } from "./model";
import { numbered } from "./parts";
import { EMPTY } from "./schema";
import { viewer } from "./stage";
import {
  change, character, characters, doc, notice, online, ownTakes, playing, take, takes, time,
} from "./state";
import type { Doc } from "./types";
import type { Viewer } from "./viewer";

/** Where the given camera sees something of the character at a time, one byte a pixel. */
function silhouette(view: Viewer, at: number, width: number, height: number, eye: number[], target: number[]): number[] {
  const { scene, camera, renderer, canvas } = view;
  const { background, fog } = scene;
  const { position, quaternion } = camera.clone();
  const ratio = renderer.getPixelRatio();
  const pane = view.panes[0];
  const shown = scene.children.filter((child) => child !== pane?.model.group && child.visible);
  for (const child of shown) {
    child.visible = false;
  }
  scene.fog = null;
  scene.background = new Color(0x00ff00);
  scene.overrideMaterial = new MeshBasicMaterial({ color: 0xff00ff, side: 2 });
  renderer.setPixelRatio(1);
  renderer.setSize(width, height, false);
  renderer.setScissorTest(false);
  renderer.setViewport(0, 0, width, height);
  camera.position.fromArray(eye);
  camera.lookAt(new Vector3().fromArray(target));
  camera.clearViewOffset();
  camera.aspect = width / height;
  camera.zoom = 1;
  camera.updateProjectionMatrix();
  if (pane) {
    pose(pane.model, pane.clip, at);
  }
  renderer.render(scene, camera);
  const flat = document.createElement("canvas");
  flat.width = width;
  flat.height = height;
  const paper = flat.getContext("2d");
  paper?.drawImage(canvas, 0, 0);
  const pixels = paper?.getImageData(0, 0, width, height).data ?? new Uint8ClampedArray();
  const out: number[] = [];
  for (let place = 0; place < width * height; place += 1) {
    out.push((pixels[place * 4] ?? 0) > 127 ? 1 : 0);
  }
  scene.overrideMaterial = null;
  Object.assign(scene, { background, fog });
  for (const child of shown) {
    child.visible = true;
  }
  camera.position.copy(position);
  camera.quaternion.copy(quaternion);
  renderer.setPixelRatio(ratio);
  view.touch();
  return out;
}

Object.assign(window, {
  studio: {
    /** On the oldest character and its oldest take that is done, which nobody changes, with nothing asked for. */
    fresh: (values: Partial<Doc>) => {
      const first = characters.value.find((one) => one.state === "ready") ?? null;
      const own = takes.value.filter((one) => one.character === first?.id && one.state === "done");
      const oldest = own.sort((one, other) => one.created - other.created)[0];
      doc.value = { ...EMPTY, character: first?.id ?? null, take: oldest?.id ?? null, ...values };
    },
    doc,
    take,
    character,
    takes: ownTakes,
    notice,
    numbered,
    online,
    playing,
    time,
    change,
    view: () => viewer,
    stream: () => stream,
    silhouette: (at: number, width: number, height: number, eye: number[], target: number[]) =>
      viewer ? silhouette(viewer, at, width, height, eye, target) : [],
    set: (seconds: number) => {
      playing.value = false;
      time.value = seconds;
      viewer?.draw(true);
    },
  },
});
