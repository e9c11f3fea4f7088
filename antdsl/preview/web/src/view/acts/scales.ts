// The colour scale of each displayed field, with numbers.

import * as THREE from "three";
import { SHOWN, fullOf } from "../scales";
import type { Sight } from "../sight";

const TICKS = [0, 2, 3, 5]; // powers of ten above the minimum, of SHOWN in total

export function scales({ stage, store }: Sight): void {
  const box = document.createElement("div");
  box.className = "sight-scales";
  box.setAttribute("role", "group");
  box.setAttribute("aria-label", "Fields");
  stage.place.append(box);

  function renew(): void {
    const fields = (store.now.scene?.fields ?? []).filter((field) => store.now.fields.includes(field.name));
    box.hidden = fields.length === 0;
    box.replaceChildren(...fields.map(({ name, colour }) => scale(name, fullOf(store.now, name), colour)));
  }

  function scale(name: string, full: number, display: [number, number, number]): HTMLElement {
    const made = document.createElement("div");
    made.className = "sight-ramp";
    made.dataset.test = `scale-${name}`;
    const title = document.createElement("h3");
    title.textContent = name;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [256, 1];
    paint(canvas, new THREE.Color().setRGB(...display, THREE.SRGBColorSpace));
    const ends = document.createElement("p");
    for (const power of TICKS) {
      const word = document.createElement("span");
      word.textContent = Number((full / 10 ** (SHOWN - power)).toPrecision(2)).toLocaleString("en", {
        maximumSignificantDigits: 2,
      });
      word.style.left = `${(100 * power) / SHOWN}%`;
      ends.append(word);
    }
    made.append(title, canvas, ends);
    return made;
  }

  /** Return the colour as on the ground: opaque for high values, transparent for low ones. */
  function paint(canvas: HTMLCanvasElement, colour: THREE.Color): void {
    const pen = canvas.getContext("2d") as CanvasRenderingContext2D;
    const image = pen.createImageData(256, 1);
    const strong = colour.clone().lerp(stage.palette.ink, 0.55);
    const mixed = new THREE.Color();
    for (let k = 0; k < 256; k++) {
      const seen = k / 255;
      const t = Math.min(Math.max((seen - 0.45) / 0.55, 0), 1);
      mixed.copy(colour).lerp(strong, t * t * (3 - 2 * t));
      const over = stage.palette.ground
        .clone()
        .lerp(mixed, 0.72 * seen)
        .getHex(THREE.SRGBColorSpace);
      image.data.set([over >> 16, (over >> 8) & 255, over & 255, 255], 4 * k);
    }
    pen.putImageData(image, 0, 0);
  }

  store.on(["scene", "fields", "full"], renew);
  stage.palette.onChange(renew);
}
