import { byId, setAttribute, setData, setText } from "../dom";
import type { Priority } from "../wire";

const PAUSE_MS = 120_000;
/** Pulses of a burst and the time until the next burst, after IEC 60601-1-8, which has 10, 3 and 1 pulses. */
const BURSTS: Record<Priority, { offsetsS: number[]; pulseS: number; hz: number; repeatMs: number }> = {
  high: { offsetsS: [0, 0.15, 0.3, 0.55, 0.7, 1.4, 1.55, 1.7, 1.95, 2.1], pulseS: 0.1, hz: 880, repeatMs: 7_000 },
  medium: { offsetsS: [0, 0.3, 0.6], pulseS: 0.18, hz: 660, repeatMs: 15_000 },
  low: { offsetsS: [0], pulseS: 0.25, hz: 440, repeatMs: 30_000 },
};
const RISE_S = 0.02;
const VOLUME = 0.35;

/** Sounds for the highest alarm that is not acknowledged. It is silent until a person switches it on. */
export class AlarmSound {
  /** Number of bursts so far. */
  bursts = 0;
  private context: AudioContext | null = null;
  private pausedUntil = 0;
  private soundingKey = "";
  private nextBurstAt = 0;
  private readonly button = byId("sound");

  constructor() {
    this.button.addEventListener("click", () => this.toggle());
  }

  /** Switches the sound on; later pauses it for two minutes, or ends the pause. */
  toggle(): void {
    const now = performance.now();
    if (!this.context) this.switchOn();
    else if (now < this.pausedUntil) this.pausedUntil = 0;
    else this.pausedUntil = now + PAUSE_MS;
    this.show(now);
  }

  /** `key` changes with a new or a higher alarm. Null: there is no alarm to sound for. */
  render(key: string | null, priority: Priority | null, nowMs: number): void {
    this.show(nowMs);
    if (key !== this.soundingKey) {
      this.soundingKey = key ?? "";
      this.nextBurstAt = nowMs;
    }
    if (key === null || priority === null || !this.context || nowMs < this.pausedUntil || nowMs < this.nextBurstAt) return;
    this.nextBurstAt = nowMs + BURSTS[priority].repeatMs;
    this.bursts += 1;
    setData(this.button, "bursts", String(this.bursts));
    this.play(this.context, priority);
  }

  private switchOn(): void {
    this.context = new AudioContext();
    this.play(this.context, "low"); // the person hears that the sound works
  }

  private show(nowMs: number): void {
    const leftS = Math.ceil((this.pausedUntil - nowMs) / 1000);
    const state = !this.context ? "off" : leftS > 0 ? "paused" : "on";
    setData(this.button, "state", state);
    const minutes = `${Math.floor(leftS / 60)}:${String(leftS % 60).padStart(2, "0")}`;
    const text = { off: "Sound is off", on: "Pause sound", paused: `Sound paused ${minutes}` };
    setText(this.button, text[state]);
    const title = { off: "Sound is off: switch it on", on: "Pause sound for two minutes", paused: "Sound is paused: end the pause" };
    setAttribute(this.button, "title", title[state]);
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
