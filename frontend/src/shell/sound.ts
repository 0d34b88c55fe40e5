import { byId, setAttribute, setData, setText } from "../dom";
import type { Priority } from "../wire";

const PAUSE_MS = 120_000;
/** Pulses of a burst, and how long until it is repeated: after IEC 60601-1-8, which has 10, 3 and 1. */
const BURSTS: Record<Priority, { offsetsS: number[]; pulseS: number; hz: number; againMs: number }> = {
  high: { offsetsS: [0, 0.15, 0.3, 0.55, 0.7, 1.4, 1.55, 1.7, 1.95, 2.1], pulseS: 0.1, hz: 880, againMs: 7_000 },
  medium: { offsetsS: [0, 0.3, 0.6], pulseS: 0.18, hz: 660, againMs: 15_000 },
  low: { offsetsS: [0], pulseS: 0.25, hz: 440, againMs: 30_000 },
};
const RISE_S = 0.02;
const VOLUME = 0.35;

/** Speaks for the highest alarm that nobody has acknowledged; silent until a person has switched it on. */
export class AlarmSound {
  /** How many bursts have been sounded. */
  bursts = 0;
  private context: AudioContext | null = null;
  private pausedUntil = 0;
  private sounding = "";
  private dueAt = 0;
  private readonly button = byId("sound");

  constructor() {
    this.button.addEventListener("click", () => this.press());
  }

  /** Switch on; then pause for two minutes, or end the pause. */
  press(): void {
    const now = performance.now();
    if (!this.context) this.switchOn();
    else if (now < this.pausedUntil) this.pausedUntil = 0;
    else this.pausedUntil = now + PAUSE_MS;
    this.show(now);
  }

  /** `key` changes when there is a new alarm or a worse one; null: nothing to say. */
  render(key: string | null, priority: Priority | null, nowMs: number): void {
    this.show(nowMs);
    if (key !== this.sounding) {
      this.sounding = key ?? "";
      this.dueAt = nowMs;
    }
    if (key === null || priority === null || !this.context || nowMs < this.pausedUntil || nowMs < this.dueAt) return;
    this.dueAt = nowMs + BURSTS[priority].againMs;
    this.bursts += 1;
    setData(this.button, "bursts", String(this.bursts));
    this.play(this.context, priority);
  }

  private switchOn(): void {
    this.context = new AudioContext();
    this.play(this.context, "low"); // so that one hears that it works
  }

  private show(nowMs: number): void {
    const left = Math.ceil((this.pausedUntil - nowMs) / 1000);
    const state = !this.context ? "off" : left > 0 ? "paused" : "on";
    setData(this.button, "state", state);
    const minutes = `${Math.floor(left / 60)}:${String(left % 60).padStart(2, "0")}`;
    const words = { off: "Sound is off", on: "Pause sound", paused: `Sound paused ${minutes}` };
    setText(this.button, words[state]);
    const does = { off: "Sound is off: switch it on", on: "Pause sound for two minutes", paused: "Sound is paused: end the pause" };
    setAttribute(this.button, "title", does[state]);
  }

  private play(context: AudioContext, priority: Priority): void {
    const { offsetsS, pulseS, hz } = BURSTS[priority];
    void context.resume();
    for (const offset of offsetsS) {
      const begin = context.currentTime + offset;
      const gain = context.createGain();
      gain.gain.setValueAtTime(0, begin);
      gain.gain.linearRampToValueAtTime(VOLUME, begin + RISE_S);
      gain.gain.setValueAtTime(VOLUME, begin + pulseS - RISE_S);
      gain.gain.linearRampToValueAtTime(0, begin + pulseS);
      gain.connect(context.destination);
      for (const harmonic of [1, 2, 3, 4]) {
        const tone = context.createOscillator();
        const share = context.createGain();
        share.gain.value = 0.4 / harmonic;
        tone.frequency.value = hz * harmonic;
        tone.connect(share).connect(gain);
        tone.start(begin);
        tone.stop(begin + pulseS);
      }
    }
  }
}
