import type { FrameReceived, ReplayControl, ServerMessage } from "../wire";
import { decodeFrame, type Frame } from "./frame";

const FIRST_RETRY_MS = 250;
/** The close code of a server that cannot show what was asked for: asking again changes nothing. */
const REFUSED = 1008;
const LONGEST_RETRY_MS = 2000;
/** The server speaks at least once a second; a connection this silent is dead though nobody closed it. */
const SILENT_AFTER_MS = 4000;

export interface Listener {
  onMessage(message: ServerMessage, arrivedMs: number): void;
  onFrame(frame: Frame, arrivedMs: number): void;
  onConnected(connected: boolean): void;
}

/** A WebSocket to the live stream or to a replay, opened again and again until it holds. */
export class Connection {
  private socket: WebSocket | null = null;
  private retryMs = FIRST_RETRY_MS;
  private heardMs = 0;

  private watch = 0;
  private retry = 0;

  constructor(
    private readonly path: string,
    private readonly listener: Listener,
  ) {}

  start(): void {
    this.open();
    this.watch = window.setInterval(() => this.dropIfSilent(), 1000);
  }

  /** Leave for good. */
  close(): void {
    clearInterval(this.watch);
    clearTimeout(this.retry);
    const socket = this.socket;
    this.socket = null;
    if (!socket) return;
    socket.onmessage = socket.onclose = null;
    socket.close();
  }

  /** False when there is no connection to send on. */
  send(message: ReplayControl): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  private open(): void {
    const address = new URL(this.path, location.href);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.heardMs = performance.now();
    socket.onmessage = (event) => this.receive(socket, event.data);
    socket.onclose = ({ code }) => this.lost(socket, code);
  }

  private receive(socket: WebSocket, data: unknown): void {
    const now = performance.now();
    this.heardMs = now;
    if (data instanceof ArrayBuffer) {
      const frame = decodeFrame(data);
      const answer: FrameReceived = { type: "received", sequence: frame.sequence };
      socket.send(JSON.stringify(answer));
      this.listener.onFrame(frame, now);
      return;
    }
    const message = JSON.parse(String(data)) as ServerMessage;
    if (message.type === "hello") {
      this.retryMs = FIRST_RETRY_MS;
      this.listener.onConnected(true);
    }
    this.listener.onMessage(message, now);
  }

  private dropIfSilent(): void {
    if (this.socket && performance.now() - this.heardMs > SILENT_AFTER_MS) this.lost(this.socket);
  }

  private lost(socket: WebSocket, code = 0): void {
    if (socket !== this.socket) return;
    this.socket = null;
    socket.onmessage = socket.onclose = null;
    socket.close();
    this.listener.onConnected(false);
    if (code === REFUSED) return;
    this.retry = window.setTimeout(() => this.open(), this.retryMs);
    this.retryMs = Math.min(this.retryMs * 2, LONGEST_RETRY_MS);
  }
}
