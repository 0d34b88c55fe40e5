import { create, find, setAttribute, setData, setHidden, setText } from "../dom";
import { fixed, wholePercent } from "../format";
import type { Model } from "../live/model";
import type { KeyAction } from "../shell/keys";
import type { Mark, ReplayControl } from "../wire";

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10];
const JUMP_S = 2;
const SEEK_EVERY_MS = 150;
/** A jump to a grasp or mark ends this long before it, s. */
const LEAD_S = 0.3;

/** Controls a replay: play, pause, seek and speed. Also lists the alarms of the recording. */
export class ReplayBar {
  readonly keys: KeyAction[];
  private readonly position: HTMLInputElement;
  private readonly speed: HTMLSelectElement;
  private notice = "";
  private dragging = false;
  private seeking = false;
  private marksShown: readonly Mark[] | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
    name: string,
    private readonly sendControl: (control: ReplayControl) => boolean,
  ) {
    this.position = find(root, "replay-position", HTMLInputElement);
    this.speed = find(root, "replay-speed", HTMLSelectElement);
    setHidden(find(root, "replay-bar"), false);
    setData(root, "replay", "true");
    setHidden(find(root, "protocol-panel"), true);
    setText(find(root, "watch-title"), `Replay of ${name}`);
    setText(find(root, "replay-name"), name);
    setText(find(root, "grasps-heading"), "Grasps so far");
    this.speed.replaceChildren(...SPEEDS.map((speed) => new Option(`${speed} ×`, String(speed), speed === 1, speed === 1)));
    find(root, "replay-play").addEventListener("click", () => this.toggle());
    find(root, "replay-previous").addEventListener("click", () => this.toGrasp(-1));
    find(root, "replay-next").addEventListener("click", () => this.toGrasp(1));
    this.speed.addEventListener("change", () => this.send({ speed: Number(this.speed.value) }));
    this.position.addEventListener("input", () => {
      this.dragging = true;
      this.seekSoon();
    });
    this.position.addEventListener("change", () => {
      this.dragging = false;
      this.send({ position_s: Number(this.position.value) });
    });
    this.keys = [
      { key: " ", label: "Space", description: "Replay: play or pause", run: () => this.toggle() },
      { key: ",", label: ",", description: `Replay: ${JUMP_S} s back`, run: () => this.jump(-JUMP_S) },
      { key: ".", label: ".", description: `Replay: ${JUMP_S} s forward`, run: () => this.jump(JUMP_S) },
      { key: "[", label: "[", description: "Replay: the grasp before", run: () => this.toGrasp(-1) },
      { key: "]", label: "]", description: "Replay: the next grasp", run: () => this.toGrasp(1) },
    ];
  }

  /** Sets the text beside the controls: the last event, or why the recording cannot be shown. */
  showNotice(text: string): void {
    this.notice = text;
  }

  render(): void {
    const { replay, connected } = this.model;
    const ready = replay !== null && replay.prepared >= 1;
    const buttons = ["replay-play", "replay-previous", "replay-next"].map((id) => find(this.root, id, HTMLButtonElement));
    for (const control of [...buttons, this.position, this.speed]) {
      if (control.disabled === ready) control.disabled = !ready;
    }
    setText(find(this.root, "replay-note"), this.noteText(connected, ready));
    if (!replay || !ready) return;
    const length = replay.duration_s ?? 0;
    setText(find(this.root, "replay-play"), replay.playing ? "Pause" : "Play");
    setAttribute(this.position, "max", String(length));
    if (document.activeElement !== this.speed) this.speed.value = String(replay.speed);
    if (!this.dragging) this.position.value = replay.position_s.toFixed(2);
    setText(find(this.root, "replay-time"), `${fixed(replay.position_s, 1, "s")} of ${fixed(length, 1, "s")}`);
    this.renderAlarms();
    if (this.model.marks !== this.marksShown) this.listMarks(this.model.marks, replay.start_s);
  }

  /** Lists the marks of the recording, in the order of time; each one's button jumps to it. */
  private listMarks(marks: readonly Mark[], startS: number): void {
    this.marksShown = marks;
    const rows = marks.toReversed().map((mark) => {
      const position = Math.max(0, mark.at_s - startS);
      const button = create("button", "", `${fixed(position, 1, "s")} ${mark.text}`);
      button.type = "button";
      button.ariaLabel = `Jump to the mark ${mark.text}`;
      button.addEventListener("click", () => this.send({ position_s: Math.max(0, position - LEAD_S) }));
      const row = create("li");
      row.append(button);
      return row;
    });
    find(this.root, "replay-marks").replaceChildren(...rows);
  }

  private noteText(connected: boolean, ready: boolean): string {
    if (ready) return this.notice;
    const { replay } = this.model;
    if (this.notice !== "") return `This recording cannot be shown. ${this.notice}`;
    if (!connected && !replay) return "Opening the recording…";
    return `Preparing the recording: ${wholePercent(replay?.prepared ?? 0)} estimated.`;
  }

  /** Lists alarms of the recording. They sound no alarm and stay apart from the live tool's. */
  private renderAlarms(): void {
    const texts = [...this.model.alarms.values()].filter(({ active }) => active).map(({ priority, text }) => `In the recording, ${priority}: ${text}`);
    const box = find(this.root, "replay-alarms");
    if (box.textContent !== texts.join("")) box.replaceChildren(...texts.map((text) => create("li", "", text)));
  }

  /** Limits how often dragging the slider seeks: each seek transfers ten seconds of samples. */
  private seekSoon(): void {
    if (this.seeking) return;
    this.seeking = true;
    setTimeout(() => {
      this.seeking = false;
      if (this.dragging) this.send({ position_s: Number(this.position.value) });
    }, SEEK_EVERY_MS);
  }

  private toggle(): void {
    this.send({ playing: !(this.model.replay?.playing ?? false) });
  }

  private jump(seconds: number): void {
    const at = (this.model.replay?.position_s ?? 0) + seconds;
    this.send({ position_s: Math.min(Math.max(0, at), this.model.replay?.duration_s ?? 0) });
  }

  private toGrasp(direction: 1 | -1): void {
    const { replay } = this.model;
    if (!replay) return;
    const starts = replay.grasps.map((at) => Math.max(0, at - LEAD_S));
    const next = starts.find((at) => at > replay.position_s + 0.05);
    const before = starts.findLast((at) => at < replay.position_s - 1);
    this.send({ position_s: (direction > 0 ? next : before) ?? replay.position_s });
  }

  private send(control: Partial<ReplayControl>): void {
    this.sendControl({ type: "replay", ...control });
  }
}
