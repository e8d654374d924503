// A character in the scene: its mesh with its skin, coloured by handles where that is asked for.

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DynamicDrawUsage,
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
import { between, poseBones, type Clip } from "./clip";
import { copiesOf, smooth } from "./smooth";
import { Springs, type SpringDocument } from "./springs";

export interface Model {
  key: string;
  group: Group;
  bones: Bone[];
  /** Where each bone is at rest in its parent. */
  places: Vector3[];
  skins: SkinnedMesh[];
  plain: Map<SkinnedMesh, Material | Material[]>;
  /** Which mesh and primitive of the file each is: "0:1". */
  primitives: Map<SkinnedMesh, string>;
  /** The geometry of each as it is without apparel that moves on its own. */
  bare: Map<SkinnedMesh, BufferGeometry>;
  /** What swings, where the document says so. */
  springs: Springs | null;
}

const loader = new GLTFLoader();

/** The light that grazes a character from behind, so that black hair stands out from a dark background. */
export const rim = { value: new Color(0x000000) };

/** Add the light at grazing angles to a material that is lit. */
function edged(material: Material): void {
  material.onBeforeCompile = (shader) => {
    shader.uniforms["rim"] = rim;
    shader.fragmentShader = `uniform vec3 rim;\n${shader.fragmentShader}`.replace(
      "#include <opaque_fragment>",
      `float graze = 1.0 - saturate(dot(normal, normalize(vViewPosition)));
       outgoingLight += rim * graze * graze * graze * (0.6 + 0.4 * normal.y);
       #include <opaque_fragment>`,
    );
  };
}

/** The model of a GLB; `springy` where what its extras say of springs is to swing. */
export async function loadModel(key: string, data: ArrayBuffer, springy = false): Promise<Model> {
  const found = await loader.parseAsync(data, "");
  const skins: SkinnedMesh[] = [];
  found.scene.traverse((node: Object3D) => {
    if (node instanceof Mesh) {
      node.castShadow = true;
      node.frustumCulled = false; // its bounds are those of the rest pose
      const unlit = !node.geometry.getAttribute("normal");
      if (unlit) {
        smooth(node.geometry);
      }
      for (const material of [node.material].flat()) {
        if (material instanceof MeshStandardMaterial) {
          material.flatShading = material.flatShading && !unlit; // what the loader sets where there are no normals
          edged(material);
        }
      }
    }
    if (node instanceof SkinnedMesh) {
      skins.push(node);
    }
  });
  const plain = new Map(skins.map((skin) => [skin, skin.material]));
  const primitives = new Map(
    skins.map((skin) => {
      const at = found.parser.associations.get(skin) as { meshes?: number; primitives?: number } | undefined;
      return [skin, `${at?.meshes ?? 0}:${at?.primitives ?? 0}`];
    }),
  );
  const bare = new Map(skins.map((skin) => [skin, skin.geometry as BufferGeometry]));
  const bones = skins[0]?.skeleton.bones ?? [];
  const told = found.userData["springs"] as SpringDocument | undefined;
  const numbers = new Map(bones.map((bone, number) => [found.parser.associations.get(bone)?.nodes, number]));
  const springs = springy && told?.springs ? new Springs(bones, (node) => numbers.get(node) ?? -1, told) : null;
  const places = bones.map((bone) => bone.position.clone());
  return { key, group: found.scene, bones, places, skins, plain, primitives, bare, springs };
}

/** Hues far apart for neighbouring numbers, by the golden angle. */
export function handleColour(handle: number): Color {
  return new Color().setHSL(((handle * 137.508) % 360) / 360, 0.62, handle % 2 ? 0.62 : 0.48);
}

const painted = new MeshStandardMaterial({ vertexColors: true, roughness: 0.85 });
edged(painted);

const glass = new MeshStandardMaterial({ color: 0x9aa3ad, transparent: true, opacity: 0.22, depthWrite: false, side: 2 });

export type Colouring = "none" | "handles" | "weights" | "skeleton" | "chains" | "parts";

/** A colour for each vertex of the character, and which of them the rows of primitives are. */
export interface Tint {
  rows: Map<string, Uint32Array>;
  of: (vertex: number) => Color;
}

/** Show the character as it is, each vertex in a colour of its own, in those of its handles, how far one handle moves it, or
 * its skeleton or chains through it. */
export function colour(model: Model, shown: Colouring, handle: number, tint: Tint | null = null): void {
  const way = tint ? "parts" : shown === "parts" ? "none" : shown; // until the parts are there
  const through = way === "skeleton" || way === "chains";
  for (const skin of model.skins) {
    if (way === "none" || through) {
      skin.material = through ? glass : (model.plain.get(skin) ?? painted);
      continue;
    }
    const rows = tint?.rows.get(model.primitives.get(skin) ?? "");
    const geometry = model.bare.get(skin) ?? skin.geometry;
    const joints = geometry.getAttribute("skinIndex");
    const weights = geometry.getAttribute("skinWeight");
    const colours = new Float32Array(joints.count * 3);
    const mixed = new Color();
    const copies = copiesOf(geometry);
    const first = joints.count - copies.length;
    for (let vertex = 0; vertex < joints.count; vertex += 1) {
      if (tint) {
        tint.of(rows?.[vertex < first ? vertex : (copies[vertex - first] ?? 0)] ?? -1).toArray(colours, vertex * 3);
        continue;
      }
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
    if (!geometry.userData["colour"]) {
      geometry.userData["colour"] = geometry.getAttribute("color") ?? null;
    }
    geometry.setAttribute("color", new BufferAttribute(colours, 3));
    const material = painted.clone();
    edged(material);
    material.side = Array.isArray(own) ? 2 : (own?.side ?? 2);
    skin.material = material;
  }
  if (way === "none" || through) {
    for (const geometry of model.bare.values()) {
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

const spot = new Vector3();
const worn = new WeakMap<Clip, Map<SkinnedMesh, BufferGeometry>>();

/** The geometry of a mesh with positions of its own, in which a clip moves apparel; all else of it is shared. */
function dressed(bare: BufferGeometry, skin: SkinnedMesh, clip: Clip): BufferGeometry {
  const made = worn.get(clip) ?? new Map<SkinnedMesh, BufferGeometry>();
  worn.set(clip, made);
  let geometry = made.get(skin);
  if (!geometry) {
    geometry = new BufferGeometry();
    geometry.index = bare.index;
    geometry.groups = bare.groups;
    geometry.morphAttributes = bare.morphAttributes;
    geometry.morphTargetsRelative = bare.morphTargetsRelative;
    const rest = bare.getAttribute("position");
    const places = new Float32Array(rest.count * 3);
    for (let vertex = 0; vertex < rest.count; vertex += 1) {
      spot.fromBufferAttribute(rest, vertex).toArray(places, vertex * 3);
    }
    geometry.setAttribute("position", new BufferAttribute(places, 3).setUsage(DynamicDrawUsage));
    made.set(skin, geometry);
  }
  for (const name of new Set([...Object.keys(bare.attributes), ...Object.keys(geometry.attributes)])) {
    if (name !== "position") {
      const own = bare.attributes[name];
      if (own) {
        geometry.setAttribute(name, own);
      } else {
        geometry.deleteAttribute(name); // colours of handles that are not shown any more
      }
    }
  }
  return geometry;
}

/** Give back what the graphics card holds of a clip that is not shown any more. */
export function forget(clip: Clip): void {
  worn.get(clip)?.forEach((geometry) => geometry.dispose());
  worn.delete(clip);
}

/** Put apparel that leaves its skin where the clip has it at a time [s]. */
function wear(model: Model, clip: Clip | null, time: number): void {
  for (const [skin, bare] of model.bare) {
    const part = clip?.apparel?.parts.find((one) => `${one.mesh}:${one.primitive}` === model.primitives.get(skin));
    if (!clip?.apparel || !part?.rows.length) {
      skin.geometry = bare;
      continue;
    }
    const geometry = dressed(bare, skin, clip);
    const rest = bare.getAttribute("position");
    const places = geometry.getAttribute("position") as BufferAttribute;
    const { frame, next, share } = between(clip, time);
    const { unit } = clip.apparel;
    const { rows, moves } = part;
    const width = rows.length * 3;
    rows.forEach((vertex, row) => {
      spot.fromBufferAttribute(rest, vertex).toArray(places.array, vertex * 3);
      for (let axis = 0; axis < 3; axis += 1) {
        const here = moves[frame * width + row * 3 + axis] ?? 0;
        const there = moves[next * width + row * 3 + axis] ?? 0;
        const to = vertex * 3 + axis;
        places.array[to] = (places.array[to] ?? 0) + unit * (here + share * (there - here));
      }
    });
    const copies = copiesOf(bare);
    copies.forEach((vertex, number) => spot.fromBufferAttribute(places, vertex).toArray(places.array, (rest.count - copies.length + number) * 3));
    places.needsUpdate = true;
    skin.geometry = geometry;
  }
}

export function pose(model: Model, clip: Clip | null, time: number): void {
  if (clip) {
    poseBones(clip, model.bones, time);
  }
  wear(model, model.springs ? null : clip, time);
  model.group.updateMatrixWorld(true);
}

/** Let hair and clothes swing on for a time [s] where the body is now. */
export function swing(model: Model, seconds: number): void {
  model.springs?.swing(seconds);
  model.group.updateMatrixWorld(true);
}

/** Take a model back to the pose in which it was bound. */
export function rest(model: Model): void {
  for (const skin of model.skins) {
    skin.skeleton.pose();
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
    model.bare.get(skin)?.dispose();
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
