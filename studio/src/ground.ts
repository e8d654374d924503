// What a character stands on: warm ground that fades into the background, and the dark where bodies are near it.

import { BufferGeometry, CircleGeometry, Color, Float32BufferAttribute, Group, Mesh, ShaderMaterial, ShadowMaterial, Vector3, type Bone } from "three";

/** Colours of the page and of the ground in both themes, and of the light that grazes the character (linear). */
export const LOOKS = {
  light: { paper: 0xf3ece3, ground: 0xe2d2bf, mark: 0xb79d80, shadow: 0x4a2f1c, depth: 0.3, rim: new Color(0.1, 0.095, 0.085) },
  dark: { paper: 0x15120f, ground: 0x3a2c22, mark: 0x7c6450, shadow: 0x000000, depth: 0.55, rim: new Color(0.6, 0.5, 0.4) },
};
const SPOTS = 40; // joints that darken the ground at most
const HIGH = 0.16; // over its height, above which a joint darkens nothing; chosen by eye
const WIDE = 0.13; // how far the dark of a joint reaches over the character's height; chosen by eye

const PLACES = `
  varying vec3 place;
  void main() {
    vec4 world = modelMatrix * vec4(position, 1.0);
    place = world.xyz;
    gl_Position = projectionMatrix * viewMatrix * world;
  }`;

/** Ground with a faint dot at each metre, for it to be seen that a character travels. */
const GROUND = `
  uniform vec3 ground, mark, middle;
  uniform float size, unit, strength;
  varying vec3 place;
  void main() {
    float away = distance(place.xz, middle.xz) / size;
    vec2 cell = fract(place.xz / unit + 0.5) - 0.5;
    float edge = length(fwidth(place.xz / unit)) + 1e-5;
    float dot = (1.0 - smoothstep(0.016, 0.016 + edge, length(cell))) * min(1.0, 0.03 / edge);
    float fade = 1.0 - smoothstep(0.2, 3.6, away);
    gl_FragColor = vec4(mix(ground, mark, dot * strength), fade * fade);
    #include <colorspace_fragment>
  }`;

const SPOT = `
  uniform vec3 shadow;
  varying vec3 spot;
  void main() {
    float near = max(0.0, 1.0 - dot(spot.xy, spot.xy));
    gl_FragColor = vec4(shadow, spot.z * near * near);
    #include <colorspace_fragment>
  }`;

const SPOT_PLACES = `
  attribute vec3 corner;
  varying vec3 spot;
  void main() {
    spot = corner;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  }`;

export class Ground {
  readonly group = new Group();
  private readonly disc: Mesh<CircleGeometry, ShaderMaterial>;
  private readonly cast = new Mesh(new CircleGeometry(60, 48), new ShadowMaterial({ opacity: 0.25 }));
  private readonly dark: Mesh<BufferGeometry, ShaderMaterial>;
  private size = 1;
  private depth = 0.3;

  constructor() {
    const colours = { ground: { value: new Color() }, mark: { value: new Color() }, middle: { value: new Vector3() } };
    const uniforms = { ...colours, size: { value: 1 }, unit: { value: 1 }, strength: { value: 0.4 } };
    const flat = { transparent: true, depthWrite: false };
    this.disc = new Mesh(new CircleGeometry(60, 48), new ShaderMaterial({ ...flat, uniforms, vertexShader: PLACES, fragmentShader: GROUND }));
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new Float32BufferAttribute(new Float32Array(SPOTS * 18), 3));
    geometry.setAttribute("corner", new Float32BufferAttribute(new Float32Array(SPOTS * 18), 3));
    const shadow = { shadow: { value: new Color() } };
    this.dark = new Mesh(geometry, new ShaderMaterial({ ...flat, uniforms: shadow, vertexShader: SPOT_PLACES, fragmentShader: SPOT }));
    this.dark.frustumCulled = false;
    for (const mesh of [this.disc, this.cast]) {
      mesh.rotation.x = -Math.PI / 2;
    }
    this.cast.receiveShadow = true;
    [this.disc, this.dark, this.cast].forEach((mesh, order) => (mesh.renderOrder = order - 3));
    this.group.add(this.disc, this.dark, this.cast);
  }

  theme(dark: boolean): void {
    const look = LOOKS[dark ? "dark" : "light"];
    this.disc.material.uniforms["ground"]?.value.set(look.ground);
    this.disc.material.uniforms["mark"]?.value.set(look.mark);
    this.dark.material.uniforms["shadow"]?.value.set(look.shadow);
    this.cast.material.color.set(look.shadow);
    this.cast.material.opacity = look.depth * 0.75;
    this.depth = look.depth;
  }

  /** For a character of this size [m]; `marked` makes the dots plainer, for a path that is drawn. */
  fit(size: number, marked = false): void {
    this.size = size;
    const unit = 10 ** Math.round(Math.log10(size / 2));
    Object.entries({ size, unit, strength: marked ? 1 : 0.4 }).forEach(([name, value]) => {
      const uniform = this.disc.material.uniforms[name];
      if (uniform) {
        uniform.value = value;
      }
    });
    this.disc.scale.setScalar(size / 8);
    this.cast.scale.setScalar(size / 8);
  }

  /** Around a place [m], darkened where bones are near the ground. */
  under(x: number, z: number, bones: readonly Bone[]): void {
    this.disc.position.set(x, 0, z);
    this.disc.material.uniforms["middle"]?.value.set(x, 0, z);
    this.cast.position.set(x, 0.0006 * this.size, z);
    const places = this.dark.geometry.getAttribute("position");
    const corners = this.dark.geometry.getAttribute("corner");
    const point = new Vector3();
    const low = bones
      .map((bone) => bone.getWorldPosition(point).toArray())
      .filter(([, y]) => y < HIGH * this.size)
      .sort((one, other) => one[1] - other[1])
      .slice(0, SPOTS);
    low.forEach(([px, py, pz], number) => {
      const near = 1 - Math.max(py, 0) / (HIGH * this.size);
      const reach = WIDE * this.size;
      [[-1, -1], [-1, 1], [1, 1], [-1, -1], [1, 1], [1, -1]].forEach(([u = 0, v = 0], corner) => {
        places.setXYZ(number * 6 + corner, px + u * reach, 0.0003 * this.size, pz + v * reach);
        corners.setXYZ(number * 6 + corner, u, v, this.depth * near * near);
      });
    });
    this.dark.geometry.setDrawRange(0, low.length * 6);
    places.needsUpdate = true;
    corners.needsUpdate = true;
  }
}
