// The socket: opens it, tells who listens, opens it again when it breaks.

import { type Ask, type Packet, type Told, unpack } from "./protocol";

type Op = Told["op"];
type Of<K extends Op> = Extract<Told, { op: K }>;
type Listener = (message: never) => void;

const WAIT = [250, 500, 1000, 2000, 4000];

export class Connection {
  private socket: WebSocket | null = null;
  private tries = 0;
  private readonly heard = new Map<string, Listener[]>();
  private readonly shown: ((packet: Packet) => void)[] = [];
  private readonly lasting = new Map<string, Ask>(); // what is asked again of a server that comes back
  private readonly states: ((open: boolean, words: string) => void)[] = [];

  constructor(
    private readonly address: string,
    private token: string,
  ) {}

  /** Come back with this one. */
  keep(token: string): void {
    this.token = token;
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
    if (lasting) this.lasting.set(message.op, message);
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  open(): void {
    const socket = new WebSocket(this.address, ["antdsl.1", `token.${this.token}`]);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.tries = 0;
      this.tell(true, "");
      for (const message of this.lasting.values()) socket.send(JSON.stringify(message));
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (typeof event.data === "string") {
        const message = JSON.parse(event.data) as Told;
        for (const listener of this.heard.get(message.op) ?? []) listener(message as never);
      } else {
        const packet = unpack(event.data);
        for (const listener of this.shown) listener(packet);
      }
    };
    socket.onclose = (event) => {
      if (event.code === 1008) {
        this.tell(false, "This page is not let in: open the address that the terminal shows.");
        return;
      }
      const wait = WAIT[Math.min(this.tries++, WAIT.length - 1)] as number;
      this.tell(false, "The preview does not answer. What you see is old; it goes on as soon as it is back.");
      setTimeout(() => this.open(), wait);
    };
  }

  private tell(open: boolean, words: string): void {
    for (const listener of this.states) listener(open, words);
  }
}
