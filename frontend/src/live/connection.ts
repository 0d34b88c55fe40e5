import type { FrameReceived, ReplayControl, ServerMessage } from "../wire";
import { decodeFrame, type Frame } from "./frame";

const FIRST_RETRY_MS = 250;
/** Close code of a server that cannot show the requested recording: a retry would not help. */
const POLICY_VIOLATION = 1008;
const LONGEST_RETRY_MS = 2000;
/** The server sends at least once a second. After this silence the connection counts as lost, even if still open. */
const SILENT_AFTER_MS = 4000;

export interface Listener {
  onMessage(message: ServerMessage, arrivedMs: number): void;
  onFrame(frame: Frame, arrivedMs: number): void;
  onConnected(connected: boolean): void;
}

/** A WebSocket to the live stream or to a replay. It reconnects until `close`. */
export class Connection {
  private socket: WebSocket | null = null;
  private retryMs = FIRST_RETRY_MS;
  private lastMessageMs = 0;
  /** Number of the last event received; null if the server has not said it. */
  private lastEvent: number | null = null;

  private silenceTimer = 0;
  private retryTimer = 0;

  constructor(
    private readonly path: string,
    private readonly listener: Listener,
  ) {}

  start(): void {
    this.open();
    this.silenceTimer = window.setInterval(() => this.dropIfSilent(), 1000);
  }

  /** Closes the connection for good. */
  close(): void {
    clearInterval(this.silenceTimer);
    clearTimeout(this.retryTimer);
    const socket = this.socket;
    this.socket = null;
    if (!socket) return;
    socket.onmessage = socket.onclose = null;
    socket.close();
  }

  /** Sends a message. Returns false if there is no connection. */
  send(message: ReplayControl): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  private open(): void {
    const address = new URL(this.path, location.href);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    if (this.lastEvent !== null) address.searchParams.set("after", String(this.lastEvent));
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.lastMessageMs = performance.now();
    socket.onmessage = (event) => this.receive(socket, event.data);
    socket.onclose = ({ code }) => this.onLost(socket, code);
  }

  private receive(socket: WebSocket, data: unknown): void {
    const now = performance.now();
    this.lastMessageMs = now;
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
      if (message.resumed !== true) this.lastEvent = null;
      this.listener.onConnected(true);
    }
    this.lastEvent = eventNumber(message) ?? this.lastEvent;
    this.listener.onMessage(message, now);
  }

  private dropIfSilent(): void {
    if (this.socket && performance.now() - this.lastMessageMs > SILENT_AFTER_MS) this.onLost(this.socket);
  }

  private onLost(socket: WebSocket, code = 0): void {
    if (socket !== this.socket) return;
    this.socket = null;
    socket.onmessage = socket.onclose = null;
    socket.close();
    this.listener.onConnected(false);
    if (code === POLICY_VIOLATION) return;
    this.retryTimer = window.setTimeout(() => this.open(), this.retryMs);
    this.retryMs = Math.min(this.retryMs * 2, LONGEST_RETRY_MS);
  }
}

/** Returns the number of the newest event that has been received with this message, if it says so. */
function eventNumber(message: ServerMessage): number | null {
  if (message.type === "state") return message.event_number;
  return "number" in message ? message.number : null;
}
