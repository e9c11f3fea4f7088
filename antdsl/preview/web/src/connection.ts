// The socket: opens it, tells who listens, opens it again when it breaks.

import { type Ask, type Packet, type Told, unpack } from "./protocol";

type Op = Told["op"];
type Of<K extends Op> = Extract<Told, { op: K }>;
type Listener = (message: never) => void;

const WAIT = [250, 500, 1000, 2000, 4000];
const LATER = 10_000; // the same while another preview has the port

export class Connection {
  private socket: WebSocket | null = null;
  private tries = 0;
  private key: CryptoKey | null = null; // kept in memory alone, and never sent
  private readonly heard = new Map<string, Listener[]>();
  private readonly shown: ((packet: Packet) => void)[] = [];
  private readonly lasting = new Map<string, Ask>(); // what is asked again of a server that comes back
  private readonly states: ((open: boolean, words: string) => void)[] = [];

  constructor(
    private readonly address: string,
    private token: string,
  ) {}

  /** Come back with this one; and with a key, to a server that is started again, which has another token. */
  async keep(token: string | undefined, key: string | undefined): Promise<void> {
    if (token) this.token = token;
    if (!key || !globalThis.crypto?.subtle) return;
    this.key = await crypto.subtle.importKey("raw", new TextEncoder().encode(key), { name: "HMAC", hash: "SHA-256" }, false, [
      "sign",
    ]);
  }

  /** Prove that this page was let in before: with the key, which others who listen at this port now do not learn by it. */
  private async prove(socket: WebSocket, nonce: string): Promise<void> {
    const words = new TextEncoder().encode(`antdsl return\n${location.host}\n${nonce}`);
    const proof = this.key ? new Uint8Array(await crypto.subtle.sign("HMAC", this.key, words)) : new Uint8Array();
    socket.send([...proof].map((byte) => byte.toString(16).padStart(2, "0")).join(""));
  }

  on<K extends Op>(op: K, listener: (message: Of<K>) => void): void {
    this.heard.set(op, [...(this.heard.get(op) ?? []), listener as Listener]);
  }

  onPacket(listener: (packet: Packet) => void): void {
    this.shown.push(listener);
  }

  onState(listener: (open: boolean, words: string) => void): void {
    this.states.push(listener);
  }

  /** Ask now; lost when nobody is there, unless it is `lasting`: then the last one of its kind is asked again. */
  ask(message: Ask, lasting = false): void {
    if (lasting) this.remember(message);
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** Ask this of a server that comes back, instead of what was asked last of its kind. */
  remember(message: Ask): void {
    this.lasting.set(message.op, message);
  }

  open(): void {
    const socket = new WebSocket(this.address, ["antdsl.1", `token.${this.token}`]);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (typeof event.data === "string") {
        const message = JSON.parse(event.data) as Told;
        if (message.op === "return") void this.prove(socket, message.nonce);
        if (message.op === "hello") {
          this.tries = 0;
          this.tell(true, "");
          for (const each of this.lasting.values()) socket.send(JSON.stringify(each));
        }
        for (const listener of this.heard.get(message.op) ?? []) listener(message as never);
      } else {
        const packet = unpack(event.data);
        for (const listener of this.shown) listener(packet);
      }
    };
    socket.onclose = (event) => {
      const shut = event.code === 1008;
      const wait = shut ? LATER : (WAIT[Math.min(this.tries++, WAIT.length - 1)] as number);
      if (shut) this.tell(false, "This page is not let in: open the address that the terminal shows.");
      else this.tell(false, "The preview does not answer. What you see is old; it goes on as soon as it is back.");
      if (shut && !this.key) return; // it was never let in, or does not know by what: it will not be
      setTimeout(() => this.open(), wait);
    };
  }

  private tell(open: boolean, words: string): void {
    for (const listener of this.states) listener(open, words);
  }
}
