// The WebSocket connection: opens it, passes messages to listeners, and reconnects after it closes.

import { type Ask, type Packet, type ServerMessage, unpack } from "./protocol";

type Op = ServerMessage["op"];
type MessageOf<K extends Op> = Extract<ServerMessage, { op: K }>;
type Listener = (message: never) => void;

const RECONNECT_DELAYS = [250, 500, 1000, 2000, 4000];
const BUSY_PORT_DELAY = 10_000; // reconnection delay (ms) while another preview uses the port

export class Connection {
  private socket: WebSocket | null = null;
  private attempts = 0;
  private key: CryptoKey | null = null; // held in memory only, never sent
  private readonly listeners = new Map<string, Listener[]>();
  private readonly packetListeners: ((packet: Packet) => void)[] = [];
  private readonly lastingMessages = new Map<string, Ask>(); // messages to send again after a reconnection, by `op`
  private readonly stateListeners: ((open: boolean, message: string) => void)[] = [];

  constructor(
    private readonly address: string,
    private token: string,
  ) {}

  /** Store token and key for a reconnection. With the key, the page can return to a restarted server, which has another token. */
  async storeKeys(token: string | undefined, key: string | undefined): Promise<void> {
    if (token) this.token = token;
    if (!key || !globalThis.crypto?.subtle) return;
    this.key = await crypto.subtle.importKey("raw", new TextEncoder().encode(key), { name: "HMAC", hash: "SHA-256" }, false, [
      "sign",
    ]);
  }

  /** Prove that this page had access before. The proof does not reveal the key to other processes at this port. */
  private async prove(socket: WebSocket, nonce: string): Promise<void> {
    const signed = new TextEncoder().encode(`antdsl return\n${location.host}\n${nonce}`);
    const proof = this.key ? new Uint8Array(await crypto.subtle.sign("HMAC", this.key, signed)) : new Uint8Array();
    socket.send([...proof].map((byte) => byte.toString(16).padStart(2, "0")).join(""));
  }

  on<K extends Op>(op: K, listener: (message: MessageOf<K>) => void): void {
    this.listeners.set(op, [...(this.listeners.get(op) ?? []), listener as Listener]);
  }

  onPacket(listener: (packet: Packet) => void): void {
    this.packetListeners.push(listener);
  }

  onState(listener: (open: boolean, message: string) => void): void {
    this.stateListeners.push(listener);
  }

  /** Send a message. Without a connection it is lost, unless `lasting`: then it is sent again after a reconnection. */
  ask(message: Ask, lasting = false): void {
    if (lasting) this.remember(message);
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** Send this message after each reconnection, instead of the previous one with the same `op`. */
  remember(message: Ask): void {
    this.lastingMessages.set(message.op, message);
  }

  open(): void {
    const socket = new WebSocket(this.address, ["antdsl.1", `token.${this.token}`]);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (typeof event.data === "string") {
        const message = JSON.parse(event.data) as ServerMessage;
        if (message.op === "return") void this.prove(socket, message.nonce);
        if (message.op === "hello") {
          this.attempts = 0;
          this.notifyState(true, "");
          for (const each of this.lastingMessages.values()) socket.send(JSON.stringify(each));
        }
        for (const listener of this.listeners.get(message.op) ?? []) listener(message as never);
      } else {
        const packet = unpack(event.data);
        for (const listener of this.packetListeners) listener(packet);
      }
    };
    socket.onclose = (event) => {
      const isRefused = event.code === 1008;
      const delay = isRefused
        ? BUSY_PORT_DELAY
        : (RECONNECT_DELAYS[Math.min(this.attempts++, RECONNECT_DELAYS.length - 1)] as number);
      if (isRefused) this.notifyState(false, "This page has no access. Open the address in the terminal.");
      else
        this.notifyState(false, "The preview does not answer. This view is out of date; it continues when the preview is back.");
      if (isRefused && !this.key) return; // no reconnection without a key: the server will refuse this page again
      setTimeout(() => this.open(), delay);
    };
  }

  private notifyState(open: boolean, message: string): void {
    for (const listener of this.stateListeners) listener(open, message);
  }
}
