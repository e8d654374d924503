// The view: panes side by side with a character each, a floor, a camera that follows, gizmos for pins and the path.

import {
  BufferGeometry,
  Color,
  DirectionalLight,
  Float32BufferAttribute,
  HemisphereLight,
  Line,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  NeutralToneMapping,
  PCFShadowMap,
  PerspectiveCamera,
  Plane,
  Ray,
  Raycaster,
  Scene,
  SphereGeometry,
  Spherical,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { wentTo, type Clip } from "./clip";
import { Ground, LOOKS } from "./ground";
import { carried, pose, rest, rim, swing, type Model } from "./model";
import type { Strand } from "./skeleton";
import type { LimbEnd, Pin, Vec3 } from "./types";

export interface Pane {
  model: Model;
  clip: Clip | null;
  /** The take that it shows, and whether that is its draft. */
  label?: string;
  /** Without a clip: as it was bound, whatever it was shown doing before. */
  bound?: boolean;
  draft?: boolean;
}

export interface Marks {
  ends: LimbEnd[];
  pins: Pin[];
  path: [number, number][];
  handles: { place: [number, number, number]; joint: number; colour: Color }[];
  /** Joints that are corrected, and the part that is pointed at. */
  joints: { name: string; parent: string | null; point: Vec3 }[];
  piece: Vec3 | null;
  /** Joints that bones are drawn between. */
  skeleton: [number, number][];
  /** Chains of hair and clothes. */
  chains: Strand[];
}

const ACCENT = 0xd9622b;
const FOV = 26; // degrees, that of the library's own renderer
const MOST_PIXELS = 1.5;
const BONES = new LineBasicMaterial({ color: ACCENT, depthTest: false, transparent: true });
const STRANDS = new LineBasicMaterial({ vertexColors: true, depthTest: false, transparent: true });
const SHAKE = { seconds: 1.4, rounds: 1.6, reach: 0.22 }; // how a character is shaken; reach over its size
// How near to a character the pointer is to take hold of it or to have it reach, and how far before it stands what it looks
// at and reaches for, all over its size; chosen by eye on the sample person.
const GRIPPED = 0.16;
const REACHED = 0.6;
const LOOKED = 1.2;
const HELD = 0.25;
const CLICKED = 4; // pixels that the pointer moves in a click
const FREE = 480; // pixels that a character has between two panels; where there are fewer, it stands under a low right one
const HOME = 0.12; // [s] in which what was dragged aside goes back by a factor of e

/** Pixels at the left and the right of a view that panels lie over. */
function covered(holder: HTMLElement): [number, number] {
  const view = holder.getBoundingClientRect();
  const [one, other] = ["left", "right"].map((side) => document.querySelector(`aside.${side}`)?.getBoundingClientRect());
  const beside = (panel?: DOMRect): boolean => Boolean(panel?.width && panel.width < view.width / 2); // no sheet of a phone
  const left = one && beside(one) ? Math.max(0, one.right - view.left) : 0;
  const right = other && beside(other) ? Math.max(0, view.right - other.left) : 0;
  const tall = (other?.height ?? 0) > view.height / 2;
  return [left, tall || view.width - left - right >= FREE ? right : 0];
}

export class Viewer {
  readonly renderer: WebGLRenderer;
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(FOV, 1, 0.05, 400);
  readonly controls: OrbitControls;
  readonly canvas: HTMLCanvasElement;
  panes: Pane[] = [];
  marks: Marks = { ends: [], pins: [], path: [], handles: [], joints: [], piece: null, skeleton: [], chains: [] };
  time = 0;
  follow = true;
  dragged: ((part: string, place: [number, number, number]) => void) | null = null;
  /** Hears which joint was moved where. */
  placed: ((name: string, place: Vec3) => void) | null = null;
  /** Hears where a click that moved nothing goes, and where on the view it was [pixels]. */
  pick: ((ray: Ray, left: number, top: number) => void) | null = null;
  private pressed: [number, number] | null = null;
  drew: ((path: [number, number][]) => void) | null = null;
  chosen: ((pane: number) => void) | null = null;
  /** Hears where the pointer is, before the character, and where it is pressed. */
  told: ((look: Vec3, reach: Vec3 | null) => void) | null = null;
  private reaching = false;
  drawing = false;
  directing = false;
  private dirty = true;
  private readonly floor = new Ground();
  private readonly sky = new HemisphereLight(0xfff6ea, 0xb08f73, 1.7);
  private readonly sun = new DirectionalLight(0xfff1de, 1.9);
  private readonly fill = new DirectionalLight(0xdfe8ff, 0.5);
  private readonly gizmos: Mesh[] = [];
  private readonly dots: Mesh[] = [];
  /** Paints where a ray goes; whether it met something. */
  paint: ((ray: Ray) => boolean) | null = null;
  painted: (() => void) | null = null;
  /** Whether springs of models swing. */
  live = false;
  private stroking = false;
  private readonly aside = new Vector3(); // how far the character is dragged or shaken from its place [m]
  private grip: { plane: Plane; from: Vector3 } | null = null;
  private shaken = Infinity; // seconds since it was
  private passed = 0; // seconds to swing on
  private line: Line | null = null;
  private bones: LineSegments | null = null;
  private strands: LineSegments | null = null;
  private followed: [number, number] = [0, 0];
  private held: { gizmo: Mesh; plane: Plane } | null = null;
  private stroke: [number, number][] = [];
  private readonly ray = new Raycaster();
  private size = 1;
  private readonly place = new Vector3(); // the middle of the character at rest
  private covered: [number, number] = [0, 0];
  private shape = 1; // width over height of the narrowest pane that holds the character at the camera's distance

  constructor(holder: HTMLElement) {
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, MOST_PIXELS));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.canvas = this.renderer.domElement;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "the character in motion");
    holder.prepend(this.canvas);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("change", () => this.touch());
    this.controls.maxPolarAngle = Math.PI * 0.52;
    this.renderer.toneMapping = NeutralToneMapping;
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.bias = -0.0005;
    this.sun.shadow.normalBias = 0.02;
    this.sun.shadow.radius = 7;
    this.scene.add(this.sky, this.sun, this.sun.target, this.fill, this.fill.target, this.floor.group);
    this.theme(false);
    const watch = new ResizeObserver(() => this.fit(holder));
    [holder, ...document.querySelectorAll("aside")].forEach((each) => watch.observe(each));
    this.fit(holder);
    this.canvas.addEventListener("pointerdown", (event) => this.down(event));
    this.canvas.addEventListener("pointermove", (event) => this.move(event));
    this.canvas.addEventListener("pointerup", (event) => this.up(event));
  }

  touch(): void {
    this.dirty = true;
  }

  /** How large the character is [m]. */
  get extent(): number {
    return this.size;
  }

  /** The ray through the middle of what is free of the view. */
  middle(): Ray {
    const [left, right] = this.covered;
    this.ray.setFromCamera(new Vector2((left - right) / Math.max(this.canvas.clientWidth, 1), 0), this.camera);
    return this.ray.ray;
  }

  /** Let time pass for what swings [s]. */
  pass(seconds: number): void {
    const swings = this.live && this.panes.length === 1 && Boolean(this.panes[0]?.model.springs);
    if (!swings) {
      this.aside.set(0, 0, 0);
      return;
    }
    this.passed += seconds;
    this.shaken += seconds;
    if (this.shaken < SHAKE.seconds) {
      const left = 1 - this.shaken / SHAKE.seconds;
      this.aside.set(SHAKE.reach * this.size * left * Math.sin((2 * Math.PI * SHAKE.rounds * this.shaken) / SHAKE.seconds), 0, 0);
    } else if (!this.grip) {
      this.aside.multiplyScalar(Math.exp(-seconds / HOME));
    }
    this.touch();
  }

  /** Move the character to and fro once, for its hair and clothes to swing. */
  shake(): void {
    this.shaken = 0;
  }

  theme(dark: boolean): void {
    const look = LOOKS[dark ? "dark" : "light"];
    this.scene.background = new Color(look.paper);
    rim.value.copy(look.rim);
    this.sky.intensity = dark ? 1.1 : 1.7;
    this.fill.intensity = dark ? 0.9 : 0.5;
    this.floor.theme(dark);
    this.touch();
  }

  private fit(holder: HTMLElement): void {
    const width = Math.max(holder.clientWidth, 50);
    const height = Math.max(holder.clientHeight, 50);
    this.renderer.setSize(width, height);
    this.covered = covered(holder);
    this.touch();
    if (this.panes.length) {
      this.draw(); // at once: a canvas of another size is blank
    }
  }

  /** Look at a character of this extent from the front and aside. */
  frame(bounds: [[number, number, number], [number, number, number]] | undefined): void {
    const [low, high] = bounds ?? [
      [-0.5, 0, -0.5],
      [0.5, 1.8, 0.5],
    ];
    this.size = Math.max(high[0] - low[0], high[1] - low[1], high[2] - low[2], 1e-3);
    const middle = new Vector3((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2);
    const wide = Math.hypot(high[0] - low[0], high[2] - low[2]);
    const [left, right] = this.covered;
    const aspect = Math.max(this.canvas.clientWidth - left - right, 1) / Math.max(this.canvas.clientHeight, 1);
    this.shape = Math.min((wide * 1.25) / ((high[1] - low[1]) * 1.7 || 1), aspect);
    const away = Math.max((high[1] - low[1]) * 1.7, (wide * 1.25) / aspect) / (2 * Math.tan((FOV * Math.PI) / 360));
    const yaw = 0.56;
    const rise = 0.2;
    this.camera.near = this.size / 100;
    this.camera.far = this.size * 300;
    this.place.copy(middle);
    const [x, z] = this.root();
    this.followed = [x, z];
    this.controls.target.set(x, middle.y - 0.07 * (high[1] - low[1]), z); // room for the bar below its feet
    this.camera.position
      .set(Math.sin(yaw) * Math.cos(rise), Math.sin(rise), Math.cos(yaw) * Math.cos(rise))
      .multiplyScalar(away)
      .add(this.controls.target);
    this.floor.fit(this.size);
    const reach = this.size * 1.6;
    Object.assign(this.sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.01, far: reach * 6 });
    this.sun.shadow.camera.updateProjectionMatrix();
    this.controls.update();
    this.touch();
  }

  /** Turn the camera about what it looks at [rad], and go `nearer` times as near. */
  turn(sideways: number, up: number, nearer = 1): void {
    const { target, minPolarAngle, maxPolarAngle } = this.controls;
    const seen = new Spherical().setFromVector3(this.camera.position.clone().sub(target));
    seen.theta += sideways;
    seen.phi = Math.min(Math.max(seen.phi - up, minPolarAngle), maxPolarAngle);
    seen.radius /= nearer;
    this.camera.position.setFromSpherical(seen.makeSafe()).add(target);
    this.controls.update();
  }

  /** Where a character is over the ground. */
  private root(pane = this.panes[0]): [number, number] {
    const [x, z] = pane?.clip ? wentTo(pane.clip, pane.model.places[pane.clip.root], this.time) : [0, 0];
    return [this.place.x + x, this.place.z + z];
  }

  show(panes: Pane[]): void {
    const models = new Set(panes.map((pane) => pane.model));
    for (const { model } of this.panes) {
      if (!models.has(model)) {
        model.group.removeFromParent();
      }
    }
    this.panes = panes;
    for (const model of models) {
      this.scene.add(model.group);
    }
    this.touch();
  }

  /** Draw what has changed; true where something was drawn. */
  draw(force = false): boolean {
    if (!this.dirty && !force) {
      return false;
    }
    this.dirty = false;
    const { width, height } = this.canvas;
    const ratio = this.renderer.getPixelRatio();
    this.render(width / ratio, height / ratio);
    return true;
  }

  private render(width: number, height: number): void {
    const count = this.panes.length;
    const columns = count > 3 ? 2 : Math.max(count, 1);
    const rows = Math.max(Math.ceil(count / columns), 1);
    this.renderer.setScissorTest(false);
    this.renderer.clear(); // what panes leave free between them
    this.renderer.setScissorTest(count > 1);
    if (count === 0) {
      this.renderer.setViewport(0, 0, width, height);
      this.renderer.render(this.scene, this.camera);
      return;
    }
    const [x, z] = this.root();
    if (this.follow) {
      const step = new Vector3(x - this.followed[0], 0, z - this.followed[1]);
      this.camera.position.add(step);
      this.controls.target.add(step);
    }
    this.followed = [x, z];
    const all = new Set(this.panes.map((pane) => pane.model));
    this.panes.forEach((pane, number) => {
      for (const model of all) {
        model.group.visible = model === pane.model;
      }
      const column = number % columns;
      const row = Math.floor(number / columns);
      const wide = width / columns;
      const high = height / rows;
      const [before, behind] = count === 1 ? this.covered : [0, 0];
      this.camera.zoom = Math.min(1, (wide - before - behind) / high / this.shape);
      this.camera.setViewOffset(wide, high, (behind - before) / 2, 0, wide, high);
      if (!pane.clip && pane.bound) {
        rest(pane.model);
      }
      pane.model.group.position.copy(this.aside);
      pose(pane.model, pane.clip, this.time);
      if (pane.model.springs) {
        swing(pane.model, this.passed);
        this.passed = 0;
      }
      const own = this.follow ? this.root(pane) : [x, z];
      const aside = new Vector3((own[0] ?? 0) - x, 0, (own[1] ?? 0) - z);
      this.camera.position.add(aside);
      this.camera.updateMatrixWorld();
      this.light(x + aside.x, z + aside.z, pane.model);
      this.mark(pane, count === 1);
      const left = column * wide;
      const bottom = height - (row + 1) * high;
      this.renderer.setViewport(left, bottom, wide, high);
      this.renderer.setScissor(left, bottom, wide, high);
      this.renderer.render(this.scene, this.camera);
      this.camera.position.sub(aside);
    });
    this.camera.updateMatrixWorld();
  }

  private light(x: number, z: number, model: Model): void {
    this.sun.target.position.set(x, 0, z);
    this.sun.position.set(x + this.size * 1.1, this.size * 2.6, z + this.size * 1.5);
    this.fill.target.position.copy(this.sun.target.position);
    this.fill.position.set(x - this.size * 2, this.size * 1.2, z + this.size);
    this.floor.fit(this.size, this.drawing);
    this.floor.under(x, z, model.bones);
  }

  private ball(list: Mesh[], number: number): Mesh {
    let ball = list[number];
    if (!ball) {
      ball = new Mesh(new SphereGeometry(1, 16, 12), new MeshBasicMaterial({ depthTest: false, transparent: true }));
      ball.renderOrder = 10;
      list[number] = ball;
      this.scene.add(ball);
    }
    ball.visible = true;
    return ball;
  }

  private mark(pane: Pane, single: boolean): void {
    for (const ball of [...this.gizmos, ...this.dots]) {
      ball.visible = false;
    }
    if (single && this.directing) {
      this.marks.ends.forEach((end, number) => {
        const ball = this.ball(this.gizmos, number);
        const pinned = this.marks.pins.some((pin) => pin.part === end.part && Math.abs(pin.time - this.time) < 0.03);
        (ball.material as MeshBasicMaterial).color.set(pinned ? ACCENT : 0x2f7fd6);
        (ball.material as MeshBasicMaterial).opacity = 0.85;
        ball.scale.setScalar(this.size * 0.015);
        ball.userData["part"] = end.part;
        if (this.held?.gizmo !== ball) {
          ball.position.copy(carried(pane.model, end.handle, end.point));
        }
      });
    }
    if (single && this.placed) {
      this.marks.joints.forEach(({ name, point }, number) => {
        const ball = this.ball(this.gizmos, number);
        (ball.material as MeshBasicMaterial).color.set(0x2f7fd6);
        ball.scale.setScalar(this.size * 0.011);
        ball.userData["part"] = name;
        if (this.held?.gizmo !== ball) {
          ball.position.fromArray(point);
        }
      });
    }
    if (single && this.marks.piece) {
      const ball = this.ball(this.dots, this.marks.handles.length);
      (ball.material as MeshBasicMaterial).color.set(ACCENT);
      ball.scale.setScalar(this.size * 0.02);
      ball.position.fromArray(this.marks.piece);
    }
    if (single) {
      this.marks.handles.forEach((handle, number) => {
        const ball = this.ball(this.dots, number);
        const material = ball.material as MeshBasicMaterial;
        material.color.copy(handle.colour);
        material.opacity = 0.95;
        ball.scale.setScalar(this.size * 0.012);
        ball.position.copy(carried(pane.model, handle.joint, handle.place));
      });
    }
    const at = new Map(this.placed ? this.gizmos.filter((ball) => ball.visible).map((ball) => [String(ball.userData["part"]), ball.position]) : []);
    const limbs = this.placed ? this.marks.joints.flatMap(({ name, parent }) => [at.get(name), at.get(parent ?? "")]) : [];
    const places = limbs.flatMap((place, number) => (limbs[number ^ 1] && place ? [place] : []));
    this.joined(single ? [...places, ...this.placesOf(pane, this.marks.skeleton)] : []);
    this.laid(pane, single ? this.marks.chains : []);
    this.line?.removeFromParent();
    const path = this.stroke.length > 1 ? this.stroke : this.marks.path;
    if (path.length > 1) {
      this.line?.geometry.dispose();
      const points = path.map(([px, pz]) => new Vector3(px, 0.004 * this.size, pz));
      this.line = new Line(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color: ACCENT }));
      this.scene.add(this.line);
    }
  }

  private placesOf(pane: Pane, pairs: Marks["skeleton"]): Vector3[] {
    return pairs.flat().map((joint) => pane.model.bones[joint]?.getWorldPosition(new Vector3()) ?? new Vector3());
  }

  /** Lines between each two of some places, seen through the mesh. */
  private joined(points: Vector3[]): void {
    this.bones?.removeFromParent();
    this.bones?.geometry.dispose();
    this.bones = null;
    if (points.length) {
      this.bones = new LineSegments(new BufferGeometry().setFromPoints(points), BONES);
      this.bones.renderOrder = 9;
      this.bones.frustumCulled = false;
      this.scene.add(this.bones);
    }
  }

  /** Chains of hair and clothes, seen through the mesh: where its bones are, or with the handles that carry them. */
  private laid(pane: Pane, chains: Marks["chains"]): void {
    this.strands?.removeFromParent();
    this.strands?.geometry.dispose();
    this.strands = null;
    const points: Vector3[] = [];
    const colours: number[] = [];
    for (const { bones, chain, colour } of chains) {
      const spots = chain.points.map((place, number) => {
        const bone = pane.model.bones[bones[number] ?? -1];
        return bone ? bone.getWorldPosition(new Vector3()) : carried(pane.model, chain.joint, place);
      });
      spots.slice(1).forEach((spot, number) => {
        points.push(spots[number] as Vector3, spot);
        colours.push(...colour.toArray(), ...colour.toArray());
      });
    }
    if (points.length) {
      const geometry = new BufferGeometry().setFromPoints(points);
      geometry.setAttribute("color", new Float32BufferAttribute(colours, 3));
      this.strands = new LineSegments(geometry, STRANDS);
      this.strands.renderOrder = 9;
      this.strands.frustumCulled = false;
      this.scene.add(this.strands);
    }
  }

  /** Where a hand or a foot is now [m]. */
  endOf(part: string): [number, number, number] | null {
    const end = this.marks.ends.find((one) => one.part === part);
    const pane = this.panes[0];
    if (!end || !pane) {
      return null;
    }
    const { x, y, z } = carried(pane.model, end.handle, end.point);
    return [round(x), round(y), round(z)];
  }

  private aim(event: PointerEvent): void {
    const box = this.canvas.getBoundingClientRect();
    const at = new Vector2(
      ((event.clientX - box.left) / box.width) * 2 - 1,
      -((event.clientY - box.top) / box.height) * 2 + 1,
    );
    this.ray.setFromCamera(at, this.camera);
  }

  private ground(event: PointerEvent): [number, number] | null {
    this.aim(event);
    const hit = this.ray.ray.intersectPlane(new Plane(new Vector3(0, 1, 0), 0), new Vector3());
    return hit && hit.distanceTo(this.camera.position) < this.size * 60 ? [hit.x, hit.z] : null;
  }

  private down(event: PointerEvent): void {
    if (event.button !== 0) {
      return;
    }
    this.pressed = [event.clientX, event.clientY];
    if (this.panes.length > 1) {
      const box = this.canvas.getBoundingClientRect();
      const columns = this.panes.length > 3 ? 2 : this.panes.length;
      const rows = Math.ceil(this.panes.length / columns);
      const column = Math.floor(((event.clientX - box.left) / box.width) * columns);
      const row = Math.floor(((event.clientY - box.top) / box.height) * rows);
      this.chosen?.(row * columns + column);
      return;
    }
    if (this.paint) {
      this.aim(event);
      if (this.paint(this.ray.ray)) {
        this.stroking = true;
        this.controls.enabled = false;
        this.canvas.setPointerCapture(event.pointerId);
      }
      return;
    }
    if (this.drawing) {
      const place = this.ground(event);
      this.stroke = place ? [place] : [];
      this.controls.enabled = false;
      this.canvas.setPointerCapture(event.pointerId);
      return;
    }
    this.aim(event);
    if (this.told && this.near(REACHED)) {
      this.reaching = true;
      this.controls.enabled = false;
      this.canvas.setPointerCapture(event.pointerId);
      this.move(event);
      return;
    }
    if (!this.directing && !this.placed) {
      this.gripped(event);
      return;
    }
    const near = this.gizmos.filter((gizmo) => gizmo.visible);
    for (const gizmo of near) {
      gizmo.geometry.computeBoundingSphere();
    }
    const hit = this.ray.intersectObjects(near)[0];
    if (hit) {
      const gizmo = hit.object as Mesh;
      const normal = this.camera.getWorldDirection(new Vector3()).negate();
      this.held = { gizmo, plane: new Plane().setFromNormalAndCoplanarPoint(normal, gizmo.position) };
      this.controls.enabled = false;
      this.canvas.setPointerCapture(event.pointerId);
    } else {
      this.gripped(event);
    }
  }

  /** Take hold of a character whose springs are live, where the ray passes near its middle. */
  private gripped(event: PointerEvent): void {
    const body = this.panes[0]?.model.bones[0];
    if (!this.live || !this.panes[0]?.model.springs || !body) {
      return;
    }
    const place = body.getWorldPosition(new Vector3());
    if (!this.near(GRIPPED)) {
      return;
    }
    const plane = new Plane().setFromNormalAndCoplanarPoint(this.camera.getWorldDirection(new Vector3()).negate(), place);
    const from = this.ray.ray.intersectPlane(plane, new Vector3());
    if (from) {
      this.grip = { plane, from: from.sub(this.aside) };
      this.shaken = Infinity;
      this.controls.enabled = false;
      this.canvas.setPointerCapture(event.pointerId);
    }
  }

  /** Whether the ray passes the character at a distance over its size. */
  private near(far: number): boolean {
    const { x, z } = this.panes[0]?.model.bones[0]?.getWorldPosition(new Vector3()) ?? new Vector3();
    const up = new Vector3(x, this.size, z);
    return this.ray.ray.distanceSqToSegment(new Vector3(x, 0, z), up) < (far * this.size) ** 2;
  }

  /** Where the ray meets an upright plane that stands before the character, at a distance over its size. */
  private before(far: number): Vec3 {
    const { x, z } = this.panes[0]?.model.bones[0]?.getWorldPosition(new Vector3()) ?? new Vector3();
    const way = this.camera.position.clone().sub(this.controls.target).setY(0).normalize();
    const plane = new Plane().setFromNormalAndCoplanarPoint(way, new Vector3(x, 0, z).addScaledVector(way, far * this.size));
    const place = this.ray.ray.intersectPlane(plane, new Vector3()) ?? new Vector3(x, this.size, z);
    return [round(place.x), round(place.y), round(place.z)];
  }

  private move(event: PointerEvent): void {
    if (this.told) {
      this.aim(event);
      this.told(this.before(LOOKED), this.reaching ? this.before(HELD) : null);
    } else if (this.stroking) {
      this.aim(event);
      this.paint?.(this.ray.ray);
    } else if (this.grip) {
      this.aim(event);
      const place = this.ray.ray.intersectPlane(this.grip.plane, new Vector3());
      if (place) {
        this.aside.copy(place.sub(this.grip.from)).clampLength(0, 2 * this.size);
      }
    } else if (this.stroke.length) {
      const place = this.ground(event);
      const before = this.stroke.at(-1);
      if (place && before && Math.hypot(place[0] - before[0], place[1] - before[1]) > this.size * 0.06) {
        this.stroke.push(place);
        this.touch();
      }
    } else if (this.held) {
      this.aim(event);
      const place = this.ray.ray.intersectPlane(this.held.plane, new Vector3());
      if (place) {
        this.held.gizmo.position.copy(place);
        this.touch();
      }
    }
  }

  private up(event: PointerEvent): void {
    const [x, y] = this.pressed ?? [Infinity, Infinity];
    if (this.pick && !this.held && Math.hypot(event.clientX - x, event.clientY - y) < CLICKED) {
      this.aim(event);
      const box = this.canvas.getBoundingClientRect();
      this.pick(this.ray.ray, event.clientX - box.left, event.clientY - box.top);
    }
    this.pressed = null;
    if (this.reaching) {
      this.reaching = false;
      this.move(event);
    } else if (this.stroking) {
      this.stroking = false;
      this.painted?.();
    } else if (this.grip) {
      this.grip = null;
    } else if (this.stroke.length) {
      const path = this.stroke;
      this.stroke = [];
      if (path.length > 2) {
        this.drew?.(path.slice(0, 200).map(([x, z]) => [round(x), round(z)]));
      }
    } else if (this.held) {
      const { gizmo } = this.held;
      this.held = null;
      const { x, y, z } = gizmo.position;
      (this.placed ?? this.dragged)?.(String(gizmo.userData["part"]), [round(x), round(y), round(z)]);
    } else {
      return;
    }
    this.canvas.releasePointerCapture(event.pointerId);
    this.controls.enabled = true;
    this.touch();
  }

}

function round(value: number): number {
  return Math.round(value * 1e4) / 1e4;
}
