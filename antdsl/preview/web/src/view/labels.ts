// Labels at positions of the world, as HTML over the picture. They stay within the view. If two would overlap, the farther one is
// reduced to its name, or hidden.

import * as THREE from "three";
import type { Stage } from "./stage";

interface Label {
  box: HTMLElement;
  name: HTMLElement;
  about: HTMLElement;
  at: THREE.Vector3;
  shown: string;
  wide: [number, number]; // px, with and without the contents
  high: number;
  measured: string; // the measured text, with all digits replaced by one: digits have equal widths
}

/** The desired position of a label: its bottom centre in px, its distance, and its size. */
export interface Wish {
  x: number;
  y: number;
  far: number;
  wide: readonly [number, number];
  high: number;
}

/** Left and top edge, and whether its text is complete; null for a label without space. */
export type Spot = { left: number; top: number; whole: boolean } | null;

/** Return the positions of labels in a view of width `width`, nearest first. */
export function arranged(wishes: readonly Wish[], width: number): Spot[] {
  const found: Spot[] = wishes.map(() => null);
  const taken: [number, number, number, number][] = [];
  const order = wishes.map((_, k) => k).sort((a, b) => (wishes[a] as Wish).far - (wishes[b] as Wish).far);
  for (const k of order) {
    const { x, y, wide, high } = wishes[k] as Wish;
    for (const whole of [true, false]) {
      const size = wide[whole ? 0 : 1];
      const left = Math.round(Math.max(Math.min(x - size / 2, width - size - EDGE), EDGE));
      const top = Math.round(y - high);
      if (taken.some(([a, b, c, d]) => left < c && left + size > a && top < d && top + high > b)) continue;
      taken.push([left, top, left + size, top + high]);
      found[k] = { left, top, whole };
      break;
    }
  }
  return found;
}

const EDGE = 4; // px between labels and the edges of the view

const POINT = new THREE.Vector3();
const AWAY = new THREE.Vector3();

export class Labels {
  private readonly all = new Map<string, Label>();
  private readonly layer = document.createElement("div");

  constructor(private readonly stage: Stage) {
    this.layer.className = "sight-labels";
    this.layer.setAttribute("aria-hidden", "true"); // panels contain the same information for screen readers
    stage.place.append(this.layer);
    stage.add(() => this.move());
  }

  /** Return a label that is `high` above a position. */
  set(key: string, name: string, about: string, at: THREE.Vector3, up: THREE.Vector3, high: number): void {
    const label = this.all.get(key) ?? this.make(key);
    label.at.copy(at).addScaledVector(up, high);
    if (label.name.textContent !== name) label.name.textContent = name;
    if (label.about.textContent !== about) label.about.textContent = about;
  }

  drop(key: string): void {
    this.all.get(key)?.box.remove();
    this.all.delete(key);
  }

  private make(key: string): Label {
    const [box, name, about] = ["div", "b", "span"].map((tag) => document.createElement(tag)) as [
      HTMLElement,
      HTMLElement,
      HTMLElement,
    ];
    box.append(name, about);
    box.style.visibility = "hidden"; // until its position is known
    this.layer.append(box);
    const label: Label = {
      box,
      name,
      about,
      at: new THREE.Vector3(),
      shown: "",
      wide: [0, 0],
      high: 0,
      measured: "",
    };
    this.all.set(key, label);
    return label;
  }

  private move(): boolean {
    const { camera, width, height } = this.stage;
    camera.updateMatrixWorld();
    const seen: Label[] = [];
    const wishes: Wish[] = [];
    for (const label of this.all.values()) {
      POINT.copy(label.at).project(camera);
      if (POINT.z < 1 && Math.abs(POINT.x) < 1.1 && Math.abs(POINT.y) < 1.1) {
        this.measure(label);
        const [x, y] = [((POINT.x + 1) / 2) * width, ((1 - POINT.y) / 2) * height];
        wishes.push({ x, y, far: AWAY.copy(label.at).distanceTo(camera.position), wide: label.wide, high: label.high });
        seen.push(label);
      } else this.put(label, null);
    }
    for (const [k, spot] of arranged(wishes, width).entries()) this.put(seen[k] as Label, spot);
    return false;
  }

  private measure(label: Label): void {
    const text = `${label.name.textContent} ${label.about.textContent}`.replace(/\d/g, "0");
    if (text === label.measured) return;
    label.measured = text;
    label.about.hidden = true;
    const bare = label.box.offsetWidth;
    label.about.hidden = false;
    label.wide = [label.box.offsetWidth, bare];
    label.high = label.box.offsetHeight;
    label.shown = "?";
  }

  private put(label: Label, spot: Spot): void {
    const shown = spot ? `translate(${spot.left}px, ${spot.top}px)` : "";
    const now = `${shown} ${spot?.whole}`;
    if (now === label.shown) return;
    label.shown = now;
    label.about.hidden = !spot?.whole;
    label.box.style.visibility = spot ? "visible" : "hidden";
    label.box.style.transform = shown;
  }
}
