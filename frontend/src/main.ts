import "./styles/theme.css";
import "./styles/layout.css";
import "./styles/header.css";
import "./styles/controls.css";
import { Connection } from "./live/connection";
import { Model } from "./live/model";
import { byId } from "./dom";
import { WatchPage } from "./pages/watch";
import { AlarmBar } from "./shell/alarms";
import { forgetHints } from "./shell/hints";
import { Keys } from "./shell/keys";
import { Person } from "./shell/person";
import { Router, type Route } from "./shell/router";
import { Session } from "./shell/session";
import { AlarmSound } from "./shell/sound";
import { Staleness } from "./shell/staleness";
import { StatusStrip } from "./shell/status";
import { StopButton } from "./shell/stop";
import { Theme } from "./shell/theme";

const model = new Model();
const session = new Session();
const person = new Person(session);
const stop = new StopButton(model, person);
const status = new StatusStrip(model);
const staleness = new Staleness(model);
const sound = new AlarmSound();
const alarms = new AlarmBar(model, sound, person);
let live: WatchPage | null = null;

const ROUTES: Route[] = [
  {
    name: "live",
    title: "Live",
    matches: (path) => path === "/",
    load: () => Promise.resolve((box) => (live = new WatchPage(box, model, person))),
  },
  {
    name: "recordings",
    title: "Replay",
    matches: (path) => path.startsWith("/recordings/"),
    load: async () => {
      const { ReplayPage } = await import("./pages/replay");
      return (box, path) => new ReplayPage(box, decodeURIComponent(path.slice("/recordings/".length)), person, schedule);
    },
  },
  {
    name: "recordings",
    title: "Recordings",
    matches: (path) => path === "/recordings",
    load: async () => {
      const { RecordingsPage } = await import("./pages/recordings");
      return (box) => new RecordingsPage(box, person);
    },
  },
  {
    name: "tissues",
    title: "Tissues",
    matches: (path) => path === "/tissues",
    load: async () => {
      const { TissuesPage } = await import("./pages/tissues");
      return (box) => new TissuesPage(box);
    },
  },
  {
    name: "studies",
    title: "Studies",
    matches: (path) => path === "/studies",
    load: async () => {
      const { StudiesPage } = await import("./pages/studies");
      return (box) => new StudiesPage(box, person);
    },
  },
  {
    name: "system",
    title: "System",
    matches: (path) => path === "/system",
    load: async () => {
      const { SystemPage } = await import("./pages/system");
      return (box) => new SystemPage(box);
    },
  },
  {
    name: "system",
    title: "Calibration",
    matches: (path) => path === "/calibration",
    load: async () => {
      const { CalibrationPage } = await import("./pages/calibration");
      return (box) => new CalibrationPage(box, person);
    },
  },
];
const router = new Router(ROUTES, schedule);
const theme = new Theme(() => router.page?.themeChanged?.());

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
  watch();
  stop.render(model.state?.run?.id ?? null);
  router.page?.render(performance.now());
  status.render();
  if (model.newestMs !== drawnMs) status.drawn(model.newestMs, performance.now());
  drawnMs = model.newestMs;
}

/** Banner and alarms; also while the tab is hidden, when nothing else is drawn. */
function watch(): void {
  const now = performance.now();
  const lost = staleness.render(now);
  alarms.render([...lost, ...stop.alarms(now), ...status.alarms()], now);
}

const connection = new Connection("/api/live", {
  onConnected: (connected) => {
    model.connected = connected;
    if (!connected) void session.check();
    if (connected && router.page === live) live?.connected();
    schedule();
  },
  onMessage: (message, arrivedMs) => {
    model.take(message, arrivedMs);
    if (message.type === "alarm") watch();
    schedule();
  },
  onFrame: (frame, arrivedMs) => {
    model.takeFrame(frame, arrivedMs);
    if (frame.history && router.page === live) live?.charts.historyChanged();
    schedule();
  },
});

function stopNow(): void {
  live?.stopped();
  void stop.stop();
}

const keys = new Keys(
  stopNow,
  [
    { key: "k", shown: "K", does: "Acknowledge the highest alarm", run: () => alarms.acknowledge() },
    { key: "m", shown: "M", does: "Show or hide all alarms", run: () => alarms.toggleList() },
    { key: "u", shown: "U", does: "Sound on; then pause it for two minutes", run: () => sound.press() },
    { key: "1", shown: "1", does: "Live page", run: () => router.go("/") },
    { key: "2", shown: "2", does: "Recordings", run: () => router.go("/recordings") },
    { key: "3", shown: "3", does: "Tissue library", run: () => router.go("/tissues") },
    { key: "4", shown: "4", does: "Studies", run: () => router.go("/studies") },
    { key: "5", shown: "5", does: "System", run: () => router.go("/system") },
    { key: "t", shown: "T", does: "Light or dark", run: () => theme.toggle() },
  ],
  () => router.page?.keys ?? [],
  () => person.close(),
);
byId("hints-again").addEventListener("click", () => {
  keys.close();
  forgetHints(document);
});
byId("stop").addEventListener("click", () => live?.stopped());

const ticker = new Worker(new URL("./shell/ticker.worker.ts", import.meta.url), { type: "module" });

void session.load().then((known) => {
  person.show();
  if (!known) return;
  ticker.onmessage = () => {
    watch();
    if (model.freshness.at(performance.now()) !== "live" || router.page !== live) schedule(); // else the next frame does
  };
  void router.show();
  connection.start();
});
