import { tissueStyles, UNKNOWN_SLOT, type TissueStyle } from "../tissues";
import type { Model } from "../live/model";
import { TRACES } from "../wire";

/** One line of a chart: its column and its look. */
export interface Trace {
  column: number;
  /** The tissue, whose lines the legend hides in all charts at once, or the name of a line of the tool. */
  key: string;
  ofTissue: boolean;
  name: string;
  mark: string;
  /** CSS custom property of its color. */
  color: string;
  dash: number[];
  /** Column of the SD of its logarithm, drawn as a band; -1 if there is none. */
  sdColumn: number;
  /** Whether the vertical scale includes it. Estimates of force do not count, because they may diverge. */
  scaled: boolean;
}

/** What the last chart shows of each filter: a parameter, its fit, or its force. */
export type Parameter = "alpha_n" | "beta_per_m" | "damping_kg_per_s" | "nis" | "force_n";

export interface PlotSpec {
  id: string;
  traces: Trace[];
  /** Unit in the heading of a chart that only the table of signals knows; the page itself has the other charts. */
  unit?: string;
}

/** Dashes of the lines of the tool, in the order in which they are drawn; the color is `--line-` and the name. */
const DASHES: Record<string, number[]> = { raw: [], measured: [], second: [2, 3], limit: [6, 4] };
const OWN_CHARTS = ["force", "displacement"];

/** Returns the lines of the tool in a chart, in the order in which they are drawn. */
const ofTool = (model: Model, chart: string): Trace[] =>
  Object.entries(DASHES).flatMap(([line, dash]) =>
    TRACES.filter((trace) => trace.chart === chart && trace.line === line).map(({ channel, label }) => ({
      column: model.column(channel),
      key: line,
      ofTissue: false,
      name: label,
      mark: line === "limit" ? label : "",
      color: `--line-${line}`,
      dash,
      sdColumn: -1,
      scaled: true,
    })),
  );

const ofTissue = (model: Model, channel: string, style: TissueStyle, scaled: boolean): Trace => ({
  column: style.slot === UNKNOWN_SLOT ? model.column(`${channel}_unknown`) : model.column(channel, style.name),
  key: style.name,
  ofTissue: true,
  name: style.title,
  mark: style.mark,
  color: `--tissue-${style.slot}`,
  dash: [],
  sdColumn: -1,
  scaled,
});

/** Channel with the SD of each parameter's logarithm; a fit and a force have none. */
const SD_OF: Record<Parameter, string> = {
  nis: "",
  force_n: "",
  alpha_n: "log_alpha_sd",
  beta_per_m: "log_beta_sd",
  damping_kg_per_s: "log_damping_sd",
};

const isRaw = ({ key }: Trace): boolean => key === "raw";
const isLimit = ({ key }: Trace): boolean => key === "limit";

/** Returns the charts with their lines, for the channels that the server sends. */
export function plotSpecs(model: Model, parameter: Parameter): PlotSpec[] {
  const styles = tissueStyles(model.tissues);
  const library = styles.filter((style) => style.slot !== UNKNOWN_SLOT);
  const force = ofTool(model, "force");
  const specs: PlotSpec[] = [
    {
      id: "force",
      traces: [
        ...force.filter(isRaw),
        ...force.filter((trace) => !isRaw(trace) && !isLimit(trace)),
        threshold(model),
        ...force.filter(isLimit),
      ],
    },
    { id: "displacement", traces: ofTool(model, "displacement") },
    ...furtherCharts(model),
    { id: "probability", traces: styles.map((style) => ofTissue(model, "probability", style, true)) },
    {
      id: "parameter",
      traces: [
        ...library.map((style) => ({
          ...ofTissue(model, parameter, style, parameter !== "force_n"),
          sdColumn: model.column(SD_OF[parameter], style.name),
        })),
        ...force.filter(({ key }) => parameter === "force_n" && key === "measured"),
      ],
    },
  ];
  return specs.map((spec) => ({ ...spec, traces: spec.traces.filter((trace) => trace.column >= 0) }));
}

/** The threshold of the force alarms, which the estimator sends and not the tool. */
const threshold = (model: Model): Trace => ({
  column: model.column("threshold_n"),
  key: "threshold",
  ofTissue: false,
  name: "alarm threshold",
  mark: "",
  color: "--line-second",
  dash: [2, 4],
  sdColumn: -1,
  scaled: true,
});

/** Returns the charts that the table of signals adds, of which the server sends a channel. */
function furtherCharts(model: Model): PlotSpec[] {
  const sent = TRACES.filter(({ chart, channel }) => !OWN_CHARTS.includes(chart) && model.column(channel) >= 0);
  const units = new Map(sent.map(({ chart, unit }) => [chart, unit]));
  return [...units].map(([id, unit]) => ({ id, unit, traces: ofTool(model, id) }));
}
