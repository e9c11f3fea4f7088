// Words that stand at places of the world: HTML over the picture.

import * as THREE from "three";
import type { Stage } from "./stage";

interface Label {
  box: HTMLElement;
  name: HTMLElement;
  about: HTMLElement;
  at: THREE.Vector3;
  shown: string;
}

const POINT = new THREE.Vector3();

export class Labels {
  private readonly all = new Map<string, Label>();
  private readonly layer = document.createElement("div");

  constructor(private readonly stage: Stage) {
    this.layer.className = "sight-labels";
    this.layer.setAttribute("aria-hidden", "true"); // the panels say the same in order
    stage.place.append(this.layer);
    stage.add(() => this.move());
  }

  /** A label `high` above a place. */
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
    box.hidden = true; // until it is known where it stands
    this.layer.append(box);
    const label = { box, name, about, at: new THREE.Vector3(), shown: "" };
    this.all.set(key, label);
    return label;
  }

  private move(): boolean {
    const { camera, width, height } = this.stage;
    camera.updateMatrixWorld();
    for (const label of this.all.values()) {
      POINT.copy(label.at).project(camera);
      const seen = POINT.z < 1 && Math.abs(POINT.x) < 1.1 && Math.abs(POINT.y) < 1.1;
      const x = Math.round(((POINT.x + 1) / 2) * width);
      const y = Math.round(((1 - POINT.y) / 2) * height);
      const shown = seen ? `translate(${x}px, ${y}px) translate(-50%, -100%)` : "";
      if (shown === label.shown) continue;
      label.shown = shown;
      label.box.hidden = !seen;
      label.box.style.transform = shown;
    }
    return false;
  }
}
