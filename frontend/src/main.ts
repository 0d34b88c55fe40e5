import "./styles/theme.css";
import "./styles/layout.css";
import "./styles/header.css";
import "./styles/controls.css";
import { Connection } from "./live/connection";
import { Model } from "./live/model";
import { motionWasAsked } from "./live/rest";
import { byId } from "./dom";
import { WatchPage } from "./pages/watch";
import { AlarmBar } from "./shell/alarms";
import { forgetHints } from "./shell/hints";
import { KeyHandler } from "./shell/keys";
import { Person } from "./shell/person";
import { Router, type Route } from "./shell/router";
import { Session } from "./shell/session";
import { AlarmSound } from "./shell/sound";
import { StalenessBanner } from "./shell/staleness";
import { QUIET_START_MS, StatusStrip } from "./shell/status";
import { StopButton } from "./shell/stop";
import { Theme } from "./shell/theme";
import { ViewChoice } from "./shell/view-choice";

const model = new Model();
const session = new Session();
const person = new Person(session);
const stop = new StopButton(model, person);
const status = new StatusStrip(model);
const staleness = new StalenessBanner(model);
const sound = new AlarmSound();
const alarms = new AlarmBar(model, sound, person);
const view = new ViewChoice(session, scheduleRender);
let live: WatchPage | null = null;

const ROUTES: Route[] = [
  {
    name: "live",
    title: "Live",
    matches: (path) => path === "/",
    load: () => Promise.resolve((box) => (live = new WatchPage(box, model, person, view))),
  },
  {
    name: "recordings",
    title: "Replay",
    matches: (path) => path.startsWith("/recordings/"),
    load: async () => {
      const { ReplayPage } = await import("./pages/replay");
      return (box, path) => new ReplayPage(box, decodeURIComponent(path.slice("/recordings/".length)), person, scheduleRender);
    },
  },
  {
    name: "recordings",
    title: "Recordings",
    matches: (path) => path === "/recordings",
    load: async () => {
      const { RecordingsPage } = await import("./pages/recordings");
      return (box) => new RecordingsPage(box, model, person);
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
    title: "Configuration",
    matches: (path) => path === "/configuration",
    load: async () => {
      const { OwnFilesPage } = await import("./pages/own-files");
      return (box) => new OwnFilesPage(box, person);
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
const router = new Router(ROUTES, scheduleRender);
const theme = new Theme(() => router.page?.themeChanged?.());

/** Longest time that the page waits for the answer who watches. */
const MAX_HIDDEN_MS = 1_000;
/** A state that is older says nothing about now; the server sends one each second, and at each change. */
const STATE_AGE_MS = 1_500;
let scheduled = false;
let drawnMs = NaN;

/** Requests one repaint for everything that arrives before it. */
function scheduleRender(): void {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(render);
}

function render(): void {
  scheduled = false;
  updateAlarms();
  stop.render(model.state?.run?.id ?? null);
  router.page?.render(performance.now());
  status.render();
  if (model.newestMs !== drawnMs) status.onDrawn(model.newestMs, performance.now());
  drawnMs = model.newestMs;
}

/** Updates banner and alarms. It also runs while the tab is hidden, when no repaint does. */
function updateAlarms(): void {
  const now = performance.now();
  const lost = staleness.render(now);
  alarms.render([...lost, ...stop.alarms(now), ...status.alarms()], now);
}

const connection = new Connection("/api/live", {
  onConnected: (connected) => {
    model.connected = connected;
    if (!connected) void session.check();
    if (connected && router.page === live) live?.connected();
    scheduleRender();
  },
  onMessage: (message, arrivedMs) => {
    model.onMessage(message, arrivedMs);
    if (message.type === "alarm") updateAlarms();
    scheduleRender();
  },
  onFrame: (frame, arrivedMs) => {
    model.onFrame(frame, arrivedMs);
    if (frame.history && router.page === live) live?.charts.historyChanged();
    scheduleRender();
  },
});

function stopNow(): void {
  live?.stopped();
  void stop.stop();
}

const keys = new KeyHandler(
  stopNow,
  () => motionWasAsked(performance.now()) || !model.standsStillSince(performance.now() - STATE_AGE_MS, performance.now()),
  [
    { key: "k", label: "K", description: "Acknowledge the highest alarm", run: () => alarms.acknowledge() },
    { key: "l", label: "L", description: "Show or hide all alarms", run: () => alarms.toggleList() },
    { key: "u", label: "U", description: "Sound on; then pause it for two minutes", run: () => sound.toggle() },
    { key: "Shift+1", label: "⇧1", description: "Live page", run: () => router.go("/") },
    { key: "Shift+2", label: "⇧2", description: "Recordings", run: () => router.go("/recordings") },
    { key: "Shift+3", label: "⇧3", description: "Tissue library", run: () => router.go("/tissues") },
    { key: "Shift+4", label: "⇧4", description: "Studies", run: () => router.go("/studies") },
    { key: "Shift+5", label: "⇧5", description: "System", run: () => router.go("/system") },
    { key: "t", label: "T", description: "Light or dark", run: () => theme.toggle() },
  ],
  () => router.page?.keys ?? [],
  () => person.close(),
);
byId("hints-again").addEventListener("click", () => {
  keys.close();
  forgetHints(document);
});
byId("stop").addEventListener("click", () => live?.stopped());

setTimeout(() => status.render(), QUIET_START_MS);

const ticker = new Worker(new URL("./shell/ticker.worker.ts", import.meta.url), { type: "module" });

/** Shows the page, once it is known who watches, because that decides the view. */
function reveal(): void {
  if (location.pathname === "/") view.open();
  document.body.dataset.program = "ready"; // before this nothing is shown, and no button that would do nothing
}
setTimeout(reveal, MAX_HIDDEN_MS);

void session.load().then((known) => {
  reveal();
  person.show();
  if (!known) return;
  ticker.onmessage = () => {
    updateAlarms();
    if (model.freshness.at(performance.now()) !== "live" || router.page !== live) scheduleRender(); // else the next frame renders it
  };
  void router.show();
  connection.start();
});
