/**
 * The view of one animation, inside a page of its own: a GLB that the page holds, a floor, a clock, a camera to turn.
 *
 * The studio's page loads the same file and takes what it needs of three.js from its exports (`vite.config.js`).
 */
import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { smooth } from "./smooth";

export { GLTFLoader, OrbitControls };
export {
  BufferAttribute, BufferGeometry, CircleGeometry, Color, DirectionalLight, DynamicDrawUsage,
  Float32BufferAttribute, Group, HemisphereLight, Line, LineBasicMaterial, LineSegments, Mesh,
  MeshBasicMaterial, MeshStandardMaterial, NeutralToneMapping, PCFShadowMap, PerspectiveCamera, Plane, Quaternion, Raycaster, Scene,
  ShaderMaterial, ShadowMaterial, SkinnedMesh, SphereGeometry, Spherical, Vector2, Vector3, WebGLRenderer,
} from "three";

async function bytes(text: string): Promise<ArrayBuffer> {
  return (await fetch(`data:application/octet-stream;base64,${text}`)).arrayBuffer();
}

function decoded(text: string): ArrayBuffer {
  const letters = atob(text);
  const out = new Uint8Array(letters.length);
  for (let k = 0; k < letters.length; k++) out[k] = letters.charCodeAt(k);
  return out.buffer;
}

async function show(): Promise<void> {
  const held = document.getElementById("model")!.textContent!.trim();
  // pages in a frame without an origin may not fetch what they hold themselves
  const data = await bytes(held).catch(() => decoded(held));
  const gltf = await new GLTFLoader().parseAsync(data, "");
  const canvas = document.querySelector("canvas")!;
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  const scene = new THREE.Scene();
  scene.background = new THREE.Color("#dfe4e9");
  scene.add(gltf.scene, new THREE.HemisphereLight("#ffffff", "#8c96a3", 2.2));
  const sun = new THREE.DirectionalLight("#ffffff", 1.8);
  sun.position.set(2, 4, 3);
  scene.add(sun);

  const clip = gltf.animations[0];
  const mixer = new THREE.AnimationMixer(gltf.scene);
  if (clip) mixer.clipAction(clip).play();
  mixer.setTime(0);
  gltf.scene.updateMatrixWorld(true);
  const box = new THREE.Box3().setFromObject(gltf.scene, true);
  const size = box.getSize(new THREE.Vector3());
  const reach = Math.max(size.x, size.y, size.z, 1e-3);
  const middle = box.getCenter(new THREE.Vector3());
  gltf.scene.traverse((thing) => {
    thing.frustumCulled = false; // bounds are those of the rest pose
    if (thing instanceof THREE.Mesh && !thing.geometry.getAttribute("normal")) {
      smooth(thing.geometry);
      for (const material of [thing.material].flat()) Object.assign(material, { flatShading: false, needsUpdate: true });
    }
  });
  const grid = new THREE.GridHelper(20 * reach, 40, "#9aa5b1", "#c3cbd4");
  grid.position.y = Math.min(box.min.y, 0);
  scene.add(grid);
  const camera = new THREE.PerspectiveCamera(35, 1, reach / 100, 100 * reach);
  camera.position.copy(middle).add(new THREE.Vector3(0.6, 0.35, 1).normalize().multiplyScalar(2.6 * reach));
  const controls = new OrbitControls(camera, canvas);
  controls.target.copy(middle);
  controls.enableDamping = true;

  const slider = document.querySelector<HTMLInputElement>("input")!;
  const button = document.querySelector("button")!;
  const length = clip?.duration ?? 0;
  let time = 0;
  let playing = !matchMedia("(prefers-reduced-motion: reduce)").matches && length > 0;
  let before = performance.now();
  const label = () => {
    button.textContent = playing ? "❚❚" : "▶";
    button.setAttribute("aria-label", playing ? "pause" : "play");
  };
  label();
  slider.max = String(length);
  slider.addEventListener("input", () => {
    playing = false;
    time = Number(slider.value);
    label();
  });
  button.addEventListener("click", () => {
    playing = !playing && length > 0;
    label();
  });
  const walker = gltf.scene.getObjectByProperty("isBone", true) ?? gltf.scene;
  const place = new THREE.Vector3();
  const last = walker.getWorldPosition(new THREE.Vector3());
  renderer.setAnimationLoop((now) => {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (canvas.width !== Math.round(width * renderer.getPixelRatio()) || camera.aspect !== width / height) {
      renderer.setSize(width, height, false);
      camera.aspect = width / Math.max(height, 1);
      camera.updateProjectionMatrix();
    }
    if (playing) time = (time + (now - before) / 1000) % Math.max(length, 1e-3);
    before = now;
    slider.value = String(time);
    mixer.setTime(time);
    gltf.scene.updateMatrixWorld(true);
    walker.getWorldPosition(place);
    const move = place.clone().sub(last).setY(0); // the camera goes where the character goes
    camera.position.add(move);
    controls.target.add(move);
    last.copy(place);
    controls.update();
    renderer.render(scene, camera);
    document.body.dataset.shown = "yes";
  });
}

if (document.getElementById("model")) {
  show().catch((error: unknown) => {
    document.body.append(`This view needs WebGL: ${String(error)}`);
  });
}
