// A character in the scene: its mesh with its skin, coloured by handles where that is asked for.

import {
  BufferAttribute,
  Color,
  Group,
  Mesh,
  MeshStandardMaterial,
  SkinnedMesh,
  Vector3,
  type Bone,
  type Material,
  type Object3D,
} from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { poseBones, type Clip } from "./clip";

export interface Model {
  key: string;
  group: Group;
  bones: Bone[];
  skins: SkinnedMesh[];
  plain: Map<SkinnedMesh, Material | Material[]>;
}

const loader = new GLTFLoader();

export async function loadModel(key: string, data: ArrayBuffer): Promise<Model> {
  const found = await loader.parseAsync(data, "");
  const skins: SkinnedMesh[] = [];
  found.scene.traverse((node: Object3D) => {
    if (node instanceof Mesh) {
      node.castShadow = true;
      node.frustumCulled = false; // its bounds are those of the rest pose
    }
    if (node instanceof SkinnedMesh) {
      skins.push(node);
    }
  });
  const plain = new Map(skins.map((skin) => [skin, skin.material]));
  return { key, group: found.scene, bones: skins[0]?.skeleton.bones ?? [], skins, plain };
}

/** Hues far apart for neighbouring numbers, by the golden angle. */
export function handleColour(handle: number): Color {
  return new Color().setHSL(((handle * 137.508) % 360) / 360, 0.62, handle % 2 ? 0.62 : 0.48);
}

const painted = new MeshStandardMaterial({ vertexColors: true, roughness: 0.85 });

/** Show the character as it is, each vertex in the colours of its handles, or how far one handle moves it. */
export function colour(model: Model, way: "none" | "handles" | "weights", handle: number): void {
  for (const skin of model.skins) {
    if (way === "none") {
      skin.material = model.plain.get(skin) ?? painted;
      continue;
    }
    const joints = skin.geometry.getAttribute("skinIndex");
    const weights = skin.geometry.getAttribute("skinWeight");
    const colours = new Float32Array(joints.count * 3);
    const mixed = new Color();
    for (let vertex = 0; vertex < joints.count; vertex += 1) {
      mixed.setRGB(0, 0, 0);
      let share = 0;
      for (let slot = 0; slot < 4; slot += 1) {
        const weight = weights.getComponent(vertex, slot);
        const joint = joints.getComponent(vertex, slot);
        const one = handleColour(joint);
        mixed.r += weight * one.r;
        mixed.g += weight * one.g;
        mixed.b += weight * one.b;
        share += joint === handle ? weight : 0;
      }
      if (way === "weights") {
        mixed.setHSL(0.66 * (1 - share), 0.75, 0.25 + 0.3 * share);
      }
      mixed.toArray(colours, vertex * 3);
    }
    const own = model.plain.get(skin);
    const geometry = skin.geometry;
    if (!geometry.userData["colour"]) {
      geometry.userData["colour"] = geometry.getAttribute("color") ?? null;
    }
    geometry.setAttribute("color", new BufferAttribute(colours, 3));
    const material = painted.clone();
    material.side = Array.isArray(own) ? 2 : (own?.side ?? 2);
    skin.material = material;
  }
  if (way === "none") {
    for (const { geometry } of model.skins) {
      const before = geometry.userData["colour"] as BufferAttribute | null | undefined;
      if (before) {
        geometry.setAttribute("color", before);
      } else if (before === null) {
        geometry.deleteAttribute("color");
      }
      delete geometry.userData["colour"];
    }
  }
}

export function pose(model: Model, clip: Clip | null, time: number): void {
  if (clip) {
    poseBones(clip, model.bones, time);
  }
  model.group.updateMatrixWorld(true);
}

const point = new Vector3();

/** Where a point of the rest pose is that moves with a joint [m]. */
export function carried(model: Model, joint: number, rest: readonly [number, number, number]): Vector3 {
  const bone = model.bones[joint];
  const skin = model.skins[0];
  const inverse = skin?.skeleton.boneInverses[joint];
  point.fromArray(rest);
  if (!bone || !skin || !inverse) {
    return point.clone();
  }
  point.applyMatrix4(skin.bindMatrix).applyMatrix4(inverse).applyMatrix4(bone.matrixWorld);
  return point.clone();
}

export function dispose(model: Model): void {
  model.group.removeFromParent();
  for (const skin of model.skins) {
    skin.geometry.dispose();
    for (const material of [skin.material, model.plain.get(skin)].flat()) {
      if (material) {
        for (const value of Object.values(material)) {
          if (value && typeof value === "object" && "isTexture" in value) {
            (value as { dispose: () => void }).dispose();
          }
        }
        material.dispose();
      }
    }
  }
}
