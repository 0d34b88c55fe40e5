import { create, find, setData, setProperty, setText } from "../dom";
import { elapsed, NO_VALUE, percent, shortTime } from "../format";
import type { Model } from "../live/model";
import { tissueStyles, UNKNOWN_SLOT, type TissueStyle } from "../tissues";
import type { Hello, Identification } from "../wire";

interface Bar {
  style: TissueStyle;
  row: HTMLElement;
  value: HTMLElement;
  light: HTMLElement;
}

/** Up to here a filter's NIS is that of a fit; from `LOST_NIS` on the filter has lost the grasp. */
const FITTING_NIS = 2;
const LOST_NIS = 50;

type Fit = "none" | "fits" | "strained" | "lost";
const FITS: Record<Fit, string> = { none: "no estimate", fits: "fits the grasp", strained: "fits badly", lost: "has lost the grasp" };

/** Shows which tissue is held, with its probability and those of the other tissues. */
export class TissueCard {
  private readonly card: HTMLElement;
  private bars: Bar[] = [];
  private barsFor: Hello["library"]["tissues"] | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
  ) {
    this.card = find(root, "tissue");
  }

  render(nowMs: number): void {
    const { hello, identification } = this.model;
    if (hello && this.barsFor !== hello.library.tissues) this.buildBars(hello);
    if (!identification || identification.grasp === 0) this.renderNothingHeld();
    else this.renderAnswer(identification, nowMs);
    setText(find(this.root, "tissue-spot"), identification ? this.spotText(identification) : "");
    this.renderBars(identification);
  }

  private spotText({ spots }: Identification): string {
    const spot = spots.at(-1);
    if (!spot) return "";
    const count = spot.grasps.length;
    const from = `from ${count} ${count === 1 ? "grasp" : "grasps"}`;
    if (count === 0) return spot.label === "no_answer" ? `Spot ${spot.index}: no answer` : `Spot ${spot.index}: new`;
    if (spot.label !== "undecided") return `Spot ${spot.index}: ${this.model.titleOf(spot.label)} ${percent(spot.probability)}, ${from}`;
    const [likeliest] = Object.entries(spot.probabilities).toSorted(([, a], [, b]) => b - a);
    return likeliest ? `Spot ${spot.index}: likeliest ${this.model.titleOf(likeliest[0])}, ${percent(likeliest[1])}, ${from}` : "";
  }

  private renderNothingHeld(): void {
    setData(this.card, "answer", "none");
    setText(find(this.root, "tissue-when"), "Held tissue");
    setText(find(this.root, "tissue-mark"), "");
    this.renderLabel(this.model.hello ? "Nothing yet" : "Connecting…");
    setText(find(this.root, "tissue-probability"), NO_VALUE);
    setText(find(this.root, "tissue-facts"), this.hint());
  }

  private hint(): string {
    const { hello, state, isStarting, lastEvent } = this.model;
    if (isStarting) return `The service is getting ready. ${lastEvent ?? ""}`;
    if (!hello) return "Waiting for the server. If this lasts, see whether it runs: graspwatch serve";
    if (this.model.isReplay) return "The answer appears with the recording's first grasp.";
    if (this.model.hasNoTool) return "This service only shows recordings: open one on the page Recordings.";
    return state?.run ? "The jaws are on their way to the first grasp." : "Choose a protocol and start it to grasp.";
  }

  private renderAnswer(held: Identification, nowMs: number): void {
    const past = !held.in_grasp;
    const isNamed = held.label !== "undecided" && held.label !== "no_answer";
    setData(this.card, "answer", isNamed ? "named" : "undecided");
    setData(this.card, "slot", !isNamed ? "" : this.slotOf(held.label));
    setData(this.card, "past", String(past));
    setText(find(this.root, "tissue-when"), past ? `Last grasp${this.sinceEnd(nowMs)}` : `${this.holding(nowMs)} · grasp ${held.grasp}`);
    setText(find(this.root, "tissue-mark"), isNamed ? this.markOf(held.label) : held.label === "undecided" ? "…" : "×");
    this.renderLabel(this.model.titleOf(held.label));
    setText(find(this.root, "tissue-probability"), !isNamed ? NO_VALUE : percent(held.probability));
    setText(find(this.root, "tissue-facts"), this.facts(held));
    if (!this.model.isReplay) setText(find(document, "label-live"), past ? "" : `Holding: ${this.model.titleOf(held.label)}`);
  }

  /** Shows the label. The stylesheet fits its size to its characters, its words and the longest of them. */
  private renderLabel(text: string): void {
    setText(find(this.root, "tissue-label"), text);
    setProperty(this.card, "--characters", text.length);
    const words = text.split(" ");
    setProperty(this.card, "--words", words.length);
    setProperty(this.card, "--word-characters", Math.max(...words.map((word) => word.length)));
  }

  private holding(nowMs: number): string {
    if (this.model.isReplay) return "Held in the recording";
    return this.model.freshness.at(nowMs) === "lost" ? "Last known" : "Holding now";
  }

  private sinceEnd(nowMs: number): string {
    const endedAt = this.model.graspEndedAt;
    return endedAt === null || this.model.isReplay ? " · over" : ` · over for ${elapsed(nowMs - endedAt)}`;
  }

  private facts(held: Identification): string {
    if (held.in_grasp && !held.in_contact) return "closing, no contact yet";
    if (held.label === "no_answer") return "a sensor failed during this grasp";
    if (held.label === "undecided") return this.undecidedFacts(held);
    const after = held.time_to_decision_s === null ? "" : `decided ${shortTime(held.time_to_decision_s)} after contact`;
    return [held.label === "unknown" ? "nothing of the library" : "", after].filter(Boolean).join(" · ");
  }

  private undecidedFacts(held: Identification): string {
    const notSure = held.in_grasp ? "not sure enough" : "never sure enough";
    const [likeliest] = Object.entries(held.probabilities).toSorted(([, a], [, b]) => b - a);
    return likeliest ? `${notSure} · likeliest ${this.model.titleOf(likeliest[0])}, ${percent(likeliest[1])}` : notSure;
  }

  private readonly slotOf = (label: string): string => this.styleOf(label)?.slot ?? UNKNOWN_SLOT;
  private readonly markOf = (label: string): string => this.styleOf(label)?.mark ?? "?";
  private readonly styleOf = (label: string): TissueStyle | undefined => this.bars.find((bar) => bar.style.name === label)?.style;

  private buildBars(hello: Hello): void {
    this.barsFor = hello.library.tissues;
    this.bars = tissueStyles(hello.library.tissues).map((style) => {
      const row = create("li");
      row.dataset.slot = style.slot;
      const track = create("span", "bar-track");
      track.append(create("span", "bar-fill"));
      const value = create("span", "bar-value");
      const light = create("span", "fit-light");
      row.append(create("span", "swatch", style.mark), create("span", "bar-name", style.title), track, value, light);
      return { style, row, value, light };
    });
    find(this.root, "tissue-bars").replaceChildren(...this.bars.map((bar) => bar.row));
  }

  private renderBars(held: Identification | null): void {
    for (const { style, row, value, light } of this.bars) {
      const share = held && held.grasp > 0 ? held.probabilities[style.name] : undefined;
      setProperty(row, "--share", share ?? 0);
      setText(value, percent(share));
      setData(row, "chosen", String(held?.grasp !== 0 && held?.label === style.name));
      if (style.slot === UNKNOWN_SLOT) continue;
      const nis = held && held.grasp > 0 ? held.nis[style.name] : undefined;
      const fit = fitOf(nis, held);
      setData(light, "fit", fit);
      light.title = `Filter of ${style.title.toLowerCase()}: ${FITS[fit]}${nis ? ` (NIS ${nis < 100 ? nis.toFixed(1) : "over 100"})` : ""}`;
    }
  }
}

function fitOf(nis: number | null | undefined, held: Identification | null): Fit {
  if (nis === undefined || !held || (nis === null && !held.in_contact)) return "none";
  if (nis === null || nis >= LOST_NIS) return "lost";
  return nis > FITTING_NIS ? "strained" : "fits";
}
