// The page: one connection, one store, and the parts of the page. A new part is one file and one line here.

import { Connection } from "./connection";
import { Store } from "./store";
import { bar } from "./panels/bar";
import { side } from "./panels/side";
import { splits } from "./panels/splits";
import { text } from "./panels/text";
import { time } from "./panels/time";
import "./panels/panels.css";
import { view } from "./view/view";

export type Part = (store: Store, place: HTMLElement) => void;

const PARTS: [string, Part][] = [
  ["bar", bar],
  ["text", text],
  ["view", view],
  ["side", side],
  ["time", time],
  ["view", splits],
];

function token(): string {
  const given = location.hash.slice(1);
  if (given) {
    sessionStorage.setItem("token", given); // still there after a reload of this tab; the address no longer contains it
    history.replaceState(null, "", location.pathname);
  }
  return given || (sessionStorage.getItem("token") ?? "");
}

const connection = new Connection(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`, token());
const store = new Store(connection);
for (const [id, part] of PARTS) part(store, document.getElementById(id) as HTMLElement);
const stale = document.getElementById("stale") as HTMLElement;
connection.onState((open, message) => {
  stale.hidden = open;
  stale.textContent = message;
});
// The server writes its build number into the page. A page with another build number (from a cache, or older than the server)
// reloads once. A second reload could loop for ever with a cache that always returns the old page.
connection.on("hello", ({ build, token: fresh, key }) => {
  if (fresh) sessionStorage.setItem("token", fresh);
  void connection.storeKeys(fresh, key);
  const own = document.querySelector<HTMLMetaElement>('meta[name="build"]')?.content;
  if (!own || own === build || sessionStorage.getItem("build") === build) return;
  sessionStorage.setItem("build", build);
  location.reload();
});
connection.open();
