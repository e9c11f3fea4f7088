// The colours of the view from the style sheet, for dark and light themes; and the perceptually uniform colour ramp for numbers.

import * as THREE from "three";

const NAMES = ["backdrop", "ground", "shape", "obstacle", "earth", "sky", "shade", "sunlight", "mark", "ink"] as const;
type Name = (typeof NAMES)[number];

export class Palette {
  readonly backdrop = new THREE.Color();
  readonly ground = new THREE.Color();
  readonly shape = new THREE.Color();
  readonly obstacle = new THREE.Color();
  readonly earth = new THREE.Color();
  readonly sky = new THREE.Color();
  readonly shade = new THREE.Color();
  readonly sunlight = new THREE.Color();
  readonly mark = new THREE.Color();
  readonly ink = new THREE.Color();
  dark = true;
  private readonly probes = new Map<Name, HTMLElement>();
  private readonly listeners: (() => void)[] = [];

  constructor(place: HTMLElement) {
    const box = document.createElement("div");
    box.hidden = true;
    for (const name of NAMES) {
      const probe = document.createElement("i");
      probe.className = `sight-${name}`;
      box.append(probe);
      this.probes.set(name, probe);
    }
    place.append(box);
    const read = () => this.read();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", read);
    const watched = { attributes: true, attributeFilter: ["style", "class", "data-theme"] };
    new MutationObserver(read).observe(document.documentElement, watched);
    this.read();
  }

  onChange(listener: () => void): void {
    this.listeners.push(listener);
  }

  private read(): void {
    for (const [name, probe] of this.probes) this[name].set(getComputedStyle(probe).color);
    const { r, g, b } = this.backdrop;
    this.dark = r + g + b < 1;
    for (const listener of this.listeners) listener();
  }
}

/** Return 256 display colours (r, g, b bytes) in even steps of lightness, from violet to yellow, also for the colour-blind. */
export const RAMP = ramp();

function ramp(): Uint8Array {
  const table = new Uint8Array(256 * 3);
  for (let k = 0; k < 256; k++) {
    const part = k / 255;
    const light = 0.44 + 0.48 * part;
    const hue = ((300 - 200 * part) * Math.PI) / 180;
    const chroma = 0.14 + 0.02 * Math.sin(Math.PI * part);
    table.set(fromOklab(light, chroma * Math.cos(hue), chroma * Math.sin(hue)), 3 * k);
  }
  return table;
}

/** Return the display bytes of a colour in Oklab (B. Ottosson, A perceptual color space for image processing, 2020). */
function fromOklab(light: number, a: number, b: number): number[] {
  const l = (light + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (light - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (light - 0.0894841775 * a - 1.291485548 * b) ** 3;
  const linear = [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
  return linear.map((x) => {
    const shown = x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
    return Math.round(255 * Math.min(Math.max(shown, 0), 1));
  });
}
