// Small pictures of clips on the character, drawn by one renderer as strips of moments, and of the character from four sides.

import { Color, DirectionalLight, HemisphereLight, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { wentTo, type Clip } from "./clip";
import { dispose, loadModel, pose, type Model } from "./model";

export const WIDE = 144;
export const HIGH = 108;
export const FRAMES = 6; // of a strip

export class Thumbs {
  private readonly renderer = new WebGLRenderer({ antialias: true, alpha: true });
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(26, WIDE / HIGH, 0.01, 400);
  private model: Model | null = null;
  private size = 1;
  private middle = new Vector3();

  constructor() {
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(WIDE, HIGH, false);
    const sun = new DirectionalLight(0xfff1de, 2);
    sun.position.set(1, 2.4, 1.6);
    this.scene.add(new HemisphereLight(0xfff6ea, 0xb08f73, 1.8), sun);
  }

  /** Take another character; what was drawn of the last one is drawn anew. */
  async show(key: string, data: ArrayBuffer, bounds: [number[], number[]] | undefined): Promise<void> {
    const model = await loadModel(key, data);
    this.forget();
    this.model = model;
    this.scene.add(model.group);
    const [low, high] = bounds ?? [[-0.5, 0, -0.5], [0.5, 1.8, 0.5]];
    const at = (corner: number[], axis: number): number => corner[axis] ?? 0;
    this.size = Math.max(...[0, 1, 2].map((axis) => at(high, axis) - at(low, axis)), 1e-3);
    this.middle.set(...([0, 1, 2].map((axis) => (at(low, axis) + at(high, axis)) / 2) as [number, number, number]));
    this.camera.near = this.size / 100;
    this.camera.far = this.size * 20;
    this.camera.updateProjectionMatrix();
  }

  forget(): void {
    if (this.model) {
      dispose(this.model);
      this.model = null;
    }
  }

  /** Give back what the graphics card holds. */
  end(): void {
    this.forget();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  /** A clip at moments through it, side by side. */
  strip(clip: Clip): HTMLCanvasElement | null {
    const out = document.createElement("canvas");
    out.width = WIDE * FRAMES;
    out.height = HIGH;
    const paper = out.getContext("2d");
    if (!this.model || !paper) {
      return null;
    }
    for (let frame = 0; frame < FRAMES; frame += 1) {
      const time = (clip.seconds * (frame + 0.5)) / FRAMES;
      pose(this.model, clip, time);
      const [x, z] = wentTo(clip, this.model.places[clip.root], time);
      const target = new Vector3(this.middle.x + x, this.middle.y, this.middle.z + z);
      this.camera.position.set(0.52, 0.22, 0.9).normalize().multiplyScalar(this.size * 2.7).add(target);
      this.camera.lookAt(target);
      this.renderer.render(this.scene, this.camera);
      paper.drawImage(this.renderer.domElement, frame * WIDE, 0);
    }
    return out;
  }

  /** The character as it rests, seen from a side: 0 the front, 0.25 its left, and so on round. */
  picture(side: number, background: string | null = null): HTMLCanvasElement {
    const out = document.createElement("canvas");
    out.width = WIDE;
    out.height = HIGH;
    const paper = out.getContext("2d");
    if (this.model && paper) {
      for (const skin of this.model.skins) {
        skin.skeleton.pose();
      }
      this.model.group.updateMatrixWorld(true);
      const angle = 2 * Math.PI * side;
      this.camera.position.set(Math.sin(angle), 0.12, Math.cos(angle)).multiplyScalar(this.size * 2.9).add(this.middle);
      this.camera.lookAt(this.middle);
      this.scene.background = background === null ? null : new Color(background);
      this.renderer.render(this.scene, this.camera);
      this.scene.background = null;
      paper.drawImage(this.renderer.domElement, 0, 0);
    }
    return out;
  }
}
