// The stage: canvas, camera, light and the drawing loop. It draws only after changes and during motion.

import * as THREE from "three";
import { Palette } from "./palette";

/** Called before each picture. Return true to request another picture, for motion. */
export type Task = (now: number) => boolean;

const SLOW = 90; // ms between pictures above which bodies are drawn with less detail
const OFTEN = 40; // number of slow pictures in a row that count; the first ones are always slow
const SUN = new THREE.Vector3(0.45, 0.8, 0.4);

export class Stage {
  readonly scene = new THREE.Scene();
  readonly camera = new THREE.PerspectiveCamera(38, 1, 0.1, 1000);
  readonly renderer: THREE.WebGLRenderer;
  readonly palette: Palette;
  readonly software: boolean;
  readonly up = new THREE.Vector3(0, 1, 0);
  readonly sun = new THREE.Vector3();
  readonly low = new THREE.Vector3(-1, -1, -1);
  readonly high = new THREE.Vector3(1, 1, 1);
  width = 1;
  height = 1;
  pictures = 0;
  slow = false; // whether drawing is slow and needs less detail
  private readonly sky = new THREE.HemisphereLight();
  private readonly light = new THREE.DirectionalLight();
  private readonly tasks: Task[] = [];
  private readonly resized: (() => void)[] = [];
  private isRequested = false;
  private before = 0;
  private late = 0; // number of slow pictures in a row

  constructor(readonly place: HTMLElement) {
    const plain = document.createElement("canvas");
    this.software = isSoftware(plain);
    // The context without antialiasing is used for drawing in software: a second context would take a third of a second.
    const canvas = this.software ? plain : document.createElement("canvas");
    canvas.tabIndex = 0;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !this.software, powerPreference: "high-performance" });
    this.renderer.setPixelRatio(this.software ? 1 : Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = this.software ? THREE.BasicShadowMap : THREE.PCFShadowMap;
    this.light.castShadow = true;
    this.light.shadow.mapSize.setScalar(this.software ? 1024 : 2048);
    this.light.shadow.autoUpdate = false; // nothing that casts a real shadow moves in most scenes
    this.scene.add(this.sky, this.light, this.light.target);
    place.append(canvas);
    this.palette = new Palette(place);
    this.palette.onChange(() => this.dress());
    new ResizeObserver(() => this.resize()).observe(place);
    document.addEventListener("visibilitychange", () => this.wake());
    canvas.addEventListener("webglcontextrestored", () => this.relight());
    this.resize();
    this.dress();
  }

  get canvas(): HTMLCanvasElement {
    return this.renderer.domElement;
  }

  /** Return the length of the diagonal of the whole scene. */
  get extent(): number {
    return Math.max(this.low.distanceTo(this.high), 1e-6);
  }

  /** Return the CSS pixels of 1 mm at a distance of 1 mm. */
  get focal(): number {
    return this.height / (2 * Math.tan((this.camera.fov * Math.PI) / 360));
  }

  add(task: Task): void {
    this.tasks.push(task);
  }

  onResize(listener: () => void): void {
    this.resized.push(listener);
  }

  /** Request another picture. */
  wake(): void {
    if (this.isRequested || document.hidden) return;
    this.isRequested = true;
    requestAnimationFrame((now) => this.draw(now));
  }

  /** Set up the light for everything between two corners. */
  frame(low: THREE.Vector3Like, high: THREE.Vector3Like, up: THREE.Vector3Like): void {
    this.low.copy(low);
    this.high.copy(high);
    this.up.copy(up).normalize();
    this.camera.up.copy(this.up);
    const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), this.up);
    this.sun.copy(SUN).normalize().applyQuaternion(turn);
    const radius = this.extent / 2;
    const centre = this.low.clone().add(this.high).multiplyScalar(0.5);
    this.sky.position.copy(this.up);
    this.light.target.position.copy(centre);
    this.light.position.copy(centre).addScaledVector(this.sun, 2 * radius);
    const eye = this.light.shadow.camera;
    eye.left = eye.bottom = -radius;
    eye.right = eye.top = radius;
    eye.near = 0.5 * radius;
    eye.far = 3.5 * radius;
    eye.up.copy(Math.abs(this.up.z) > 0.9 ? new THREE.Vector3(1, 0, 0) : new THREE.Vector3(0, 0, 1));
    eye.updateProjectionMatrix();
    this.light.shadow.normalBias = radius / 400;
    this.light.shadow.radius = 3;
    this.relight();
  }

  /** Update the shadows, because an object that casts one has appeared, disappeared or moved. */
  relight(): void {
    this.light.shadow.needsUpdate = true;
    this.wake();
  }

  private draw(now: number): void {
    this.isRequested = false;
    const gap = now - this.before;
    this.before = now;
    this.late = gap > SLOW && gap < 1000 ? this.late + 1 : 0;
    if (this.late >= OFTEN) this.slow = true;
    let moving = false;
    for (const task of this.tasks) moving = task(now) || moving;
    this.renderer.render(this.scene, this.camera);
    this.pictures++;
    if (moving) this.wake();
    else this.before = Number.NEGATIVE_INFINITY; // a pause is not a slow picture
  }

  private resize(): void {
    this.width = Math.max(this.place.clientWidth, 1);
    this.height = Math.max(this.place.clientHeight, 1);
    this.renderer.setSize(this.width, this.height, false);
    this.camera.aspect = this.width / this.height;
    this.camera.updateProjectionMatrix();
    for (const listener of this.resized) listener();
    this.wake();
  }

  private dress(): void {
    const { palette } = this;
    this.scene.background = palette.backdrop;
    this.sky.color.copy(palette.sky);
    this.sky.groundColor.copy(palette.shade);
    this.sky.intensity = palette.dark ? 2.3 : 2.5;
    this.light.color.copy(palette.sunlight);
    this.light.intensity = palette.dark ? 2.6 : 2.4;
    this.light.shadow.intensity = palette.dark ? 0.75 : 0.55;
    this.wake();
  }
}

/** Return whether the processor draws instead of a graphics card; then details are left out. The tested context is released. */
function isSoftware(canvas: HTMLCanvasElement): boolean {
  const gl = canvas.getContext("webgl2", { antialias: false, powerPreference: "high-performance" });
  if (!gl) return true;
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  const software = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
  if (!software) gl.getExtension("WEBGL_lose_context")?.loseContext();
  return software;
}
