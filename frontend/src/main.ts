import "./styles/theme.css";
import "./styles/layout.css";
import "./styles/header.css";
import "./styles/cards.css";
import "./styles/charts.css";
import "./styles/controls.css";
import { AlarmBar } from "./cards/alarms";
import { ForceCard } from "./cards/force";
import { GraspsTable } from "./cards/grasps";
import { ProtocolPanel } from "./cards/protocol";
import { Staleness } from "./cards/staleness";
import { StatusStrip } from "./cards/status";
import { StopButton } from "./cards/stop";
import { TissueCard } from "./cards/tissue";
import { ChartStack } from "./charts/stack";
import { listenToKeys } from "./keys";
import { Connection } from "./live/connection";
import { Model } from "./live/model";
import { Theme } from "./theme";

/** How often ages and alarms are brought up to date when nothing arrives. */
const TICK_MS = 100;

const model = new Model();
const stop = new StopButton(() => protocol.forget());
const tissue = new TissueCard(model);
const force = new ForceCard(model);
const charts = new ChartStack(model);
const protocol = new ProtocolPanel(model);
const grasps = new GraspsTable(model);
const status = new StatusStrip(model);
const staleness = new Staleness(model);
const alarms = new AlarmBar(model);
const theme = new Theme(() => charts.rebuild());

let scheduled = false;
let drawnMs = NaN;

/** Whatever arrives between two pictures is drawn in one go. */
function schedule(): void {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(render);
}

function render(): void {
  scheduled = false;
  const now = performance.now();
  watch();
  tissue.render(now);
  force.render();
  protocol.render();
  stop.render(model.state?.run?.id ?? null);
  grasps.render();
  status.render();
  charts.render();
  if (model.newestMs !== drawnMs) status.drawn(model.newestMs, performance.now());
  drawnMs = model.newestMs;
}

/** Ages, banner and alarms; also while the tab is hidden, when nothing else is drawn. */
function watch(): void {
  const now = performance.now();
  const lost = staleness.render(now);
  alarms.render([...lost, ...stop.alarms(), ...status.alarms()], now);
}

const connection = new Connection({
  onConnected: (connected) => {
    model.connected = connected;
    if (connected) void protocol.load();
    schedule();
  },
  onMessage: (message, arrivedMs) => {
    model.take(message, arrivedMs);
    schedule();
  },
  onFrame: (frame, arrivedMs) => {
    model.takeFrame(frame, arrivedMs);
    if (frame.history) charts.historyChanged();
    schedule();
  },
});

listenToKeys(() => void stop.stop(), [
  { key: "S", shown: "Shift + S", does: "Start the chosen protocol", run: () => protocol.submitByKey() },
  { key: "p", shown: "P", does: "Pause the charts, or go on", run: () => charts.togglePause() },
  { key: "a", shown: "A", does: "Chart of alpha", run: () => charts.choose("alpha_n") },
  { key: "b", shown: "B", does: "Chart of beta", run: () => charts.choose("beta_per_m") },
  { key: "d", shown: "D", does: "Chart of d", run: () => charts.choose("damping_kg_per_s") },
  { key: "t", shown: "T", does: "Light or dark", run: () => theme.toggle() },
]);
setInterval(() => {
  watch();
  if (model.freshness.at(performance.now()) !== "live") schedule(); // else the next frame does
}, TICK_MS);
connection.start();
