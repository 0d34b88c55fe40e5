import { find, setData, setText } from "../dom";
import { duration } from "../format";
import type { Freshness } from "../live/freshness";
import type { Model } from "../live/model";

/** Grays out old values on the watch page and shows their age. In a replay it only marks a lost connection. */
export class AgeLabels {
  private readonly ages: HTMLElement[];

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
  ) {
    this.ages = [...root.querySelectorAll<HTMLElement>("[data-age]")];
  }

  render(nowMs: number): void {
    const freshness = this.model.isReplay ? (this.model.connected ? "live" : "lost") : this.model.freshness.at(nowMs);
    setData(this.root, "freshness", freshness);
    setText(find(this.root, "live-word"), freshness === "live" && !this.model.isReplay ? "Live" : "");
    for (const element of this.ages) setText(element, this.inWords(freshness, this.model.freshness.ageMs(nowMs)));
  }

  private inWords(freshness: Freshness, ageMs: number): string {
    if (this.model.isReplay) return "";
    const old = this.model.freshness.everHadData && (freshness === "old" || freshness === "lost");
    return old ? `${duration(ageMs)} old` : "";
  }
}
