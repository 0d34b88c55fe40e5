import { create, find, setAttribute, setData, setHidden, setProperty, setText } from "../dom";
import { fixed, newtons, shortTime, wholePercent } from "../format";
import type { Model } from "../live/model";
import type { Hello } from "../wire";

/** The gauge ends a fifth above the limit, to show forces over the limit. */
const GAUGE_END = 1.2;
const ZONES = ["low", "medium", "high"] as const;
type Zone = "none" | "safe" | (typeof ZONES)[number];

/** Shows the force and its peak against the enforced limit, which each sample carries. */
export class ForceCard {
  private readonly card: HTMLElement;
  private readonly gauge: HTMLElement;
  private zonesFor: number[] | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
  ) {
    this.card = find(root, "force");
    this.gauge = find(root, "gauge");
  }

  render(): void {
    const { hello, identification } = this.model;
    if (!hello) return;
    if (this.zonesFor !== hello.warning_shares) this.markZones(hello);
    const limit = this.model.newest("limit_n");
    const filtered = this.model.newest("jaw_force_filtered_n");
    const force = Number.isFinite(filtered) ? filtered : this.model.newest("jaw_force_n");
    const share = force / limit;
    setText(find(this.root, "force-now"), newtons(force));
    this.renderZone(share, limit, hello.warning_shares);
    this.renderPeak(force, limit);
    setText(find(this.root, "force-dose"), this.doseInWords(hello));
    this.renderLimiter(share, limit);
    setProperty(this.gauge, "--share", onGauge(share));
    setAttribute(this.gauge, "aria-valuenow", Number.isFinite(share) ? String(Math.round(share * 100)) : "0");
    setAttribute(this.gauge, "aria-valuemax", String(GAUGE_END * 100));
    setText(find(this.root, "force-limit"), this.limitInWords(limit));
    setText(find(this.root, "force-scale"), hello.tool.force_scale.text);
    const threshold = identification?.threshold_n ?? hello.lowest_threshold_n;
    const owner = this.thresholdOwner(identification?.threshold_tissue ?? null);
    setText(find(this.root, "force-threshold"), `Alarms by the injury threshold of ${owner}, ${newtons(threshold)}`);
  }

  private limitInWords(limit: number): string {
    if (Number.isFinite(limit)) return `Limit ${newtons(limit)}, enforced by the limiter`;
    return this.model.isReplay ? "No limit: this recording does not say any" : "No limit is enforced";
  }

  /** The force over time on this spot, with the interval that the force scale leaves. */
  private doseInWords(hello: Hello): string {
    const dose = this.model.identification?.spot_dose_n_s;
    if (!dose) return "";
    const { value, low, high } = hello.tool.force_scale;
    const interval = low < high ? ` (${fixed((dose * low) / value, 0, "to")} ${fixed((dose * high) / value, 0, "N s")})` : "";
    return `${fixed(dose, 1, "N s")}${interval} on this spot`;
  }

  private thresholdOwner(tissue: string | null): string {
    return tissue === null ? "the library's most delicate tissue" : this.model.titleOf(tissue).toLowerCase();
  }

  private renderZone(share: number, limit: number, shares: number[]): void {
    const zone = zoneOf(share, shares);
    setData(this.card, "zone", zone);
    setText(find(this.root, "force-zone"), Number.isFinite(limit) ? zoneInWords(zone, share) : "");
  }

  /** Shows the peak of a grasp. The gauge marks it only during the grasp: later limits do not apply to it. */
  private renderPeak(force: number, limit: number): void {
    const held = this.model.identification;
    const reportedPeak = held && held.grasp > 0 ? held.peak_force_n : null;
    const mark = find(this.root, "gauge-peak");
    setHidden(mark, reportedPeak === null || !held?.in_grasp || !Number.isFinite(limit));
    if (reportedPeak === null) return setText(find(this.root, "force-peak"), "");
    if (!held?.in_grasp) return setText(find(this.root, "force-peak"), `Last peak ${newtons(reportedPeak)}`);
    const peak = force > reportedPeak ? force : reportedPeak;
    setProperty(mark, "--share", onGauge(peak / limit));
    setText(find(this.root, "force-peak"), `Peak ${newtons(peak)}` + (Number.isFinite(limit) ? ` (${wholePercent(peak / limit)})` : ""));
  }

  /** Shows the time until the force reaches the limit, and whether the limiter holds the motor back. */
  private renderLimiter(share: number, limit: number): void {
    const held = this.model.identification;
    const holding = held?.in_grasp === true && held.holding_back;
    setData(this.card, "holding", String(holding));
    const box = find(this.root, "force-holding");
    setHidden(box, !holding);
    if (holding) setText(box, `Limiter is holding the motor back${Number.isFinite(limit) ? ` under ${newtons(limit)}` : ""}`);
    const timeToLimitS = held?.in_grasp && !holding && share < 1 ? held.time_to_limit_s : null;
    setText(find(this.root, "force-forecast"), timeToLimitS === null ? "" : `Limit in ${shortTime(timeToLimitS)} at this rate`);
  }

  private markZones(hello: Hello): void {
    this.zonesFor = hello.warning_shares;
    const marks = hello.warning_shares.map((share, i) => {
      const mark = create("span", "zone", wholePercent(share));
      mark.dataset.zone = ZONES[i] ?? "high";
      setProperty(mark, "--share", onGauge(share));
      return mark;
    });
    find(this.root, "gauge-zones").replaceChildren(...marks);
  }
}

const onGauge = (share: number): number => (Number.isFinite(share) ? Math.min(1, Math.max(0, share / GAUGE_END)) : 0);

function zoneInWords(zone: Zone, share: number): string {
  if (zone === "none") return "no value";
  const percent = wholePercent(Math.max(0, share));
  return share >= 1 ? `OVER THE LIMIT: ${percent} of it` : `${percent} of the limit`;
}

function zoneOf(share: number, shares: number[]): Zone {
  if (!Number.isFinite(share)) return "none";
  const reached = shares.filter((limit) => share >= limit).length;
  return reached === 0 ? "safe" : (ZONES[reached - 1] ?? "high");
}
