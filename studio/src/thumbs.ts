// Small moving pictures of clips on the character, drawn one after the other by one renderer and copied to their cards.

import { AmbientLight, Color, DirectionalLight, HemisphereLight, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { rootAt, type Clip } from "./clip";
import { dispose, loadModel, pose, type Model } from "./model";

export const WIDE = 144;
export const HIGH = 108;
const MOST = 8; // milliseconds of a frame of the page

export interface Card {
  canvas: HTMLCanvasElement;
  clip: Clip;
}

export class Thumbs {
  /** Cards that can be seen, by the names of their clips. */
  readonly cards = new Map<string, Card>();
  /** The card that moves where others stand still. */
  lively: string | null = null;
  private readonly renderer = new WebGLRenderer({ antialias: true, alpha: true });
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(26, WIDE / HIGH, 0.01, 400);
  private model: Model | null = null;
  private size = 1;
  private middle = new Vector3();
  private drawn = new Set<string>();
  private turn = 0;

  constructor() {
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(WIDE, HIGH, false);
    const sun = new DirectionalLight(0xffffff, 2);
    sun.position.set(1, 2.4, 1.6);
    this.scene.add(new HemisphereLight(0xffffff, 0x8a8078, 1.6), new AmbientLight(0xffffff, 0.4), sun);
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
    this.cards.clear();
    this.drawn.clear();
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

  /** Draw the cards whose turn it is, as many as fit into a moment; `still` draws each once but the lively one. */
  draw(now: number, still: boolean): void {
    const names = [...this.cards.keys()];
    const end = performance.now() + MOST;
    for (let count = 0; count < names.length && performance.now() < end; count += 1) {
      this.turn = (this.turn + 1) % names.length;
      const name = names[this.turn] as string;
      if (!still || name === this.lively || !this.drawn.has(name)) {
        const { clip } = this.cards.get(name) as Card;
        this.one(name, still && name !== this.lively ? clip.seconds * 0.4 : (now / 1000) % clip.seconds);
      }
    }
  }

  private one(name: string, time: number): void {
    const card = this.cards.get(name);
    const paper = card?.canvas.getContext("2d");
    if (!card || !this.model || !paper) {
      return;
    }
    pose(this.model, card.clip, time);
    const [x, z] = rootAt(card.clip, time);
    const target = new Vector3(this.middle.x + x, this.middle.y, this.middle.z + z);
    this.camera.position.set(0.52, 0.22, 0.9).normalize().multiplyScalar(this.size * 3).add(target);
    this.camera.lookAt(target);
    this.renderer.render(this.scene, this.camera);
    paper.clearRect(0, 0, WIDE, HIGH);
    paper.drawImage(this.renderer.domElement, 0, 0);
    this.drawn.add(name);
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
