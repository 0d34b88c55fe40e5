import { Connection } from "../live/connection";
import { Model } from "../live/model";
import { getMarks, getTruths } from "../live/rest";
import type { Person } from "../shell/person";
import type { Page } from "../shell/router";
import { ReplayBar } from "./replay-bar";
import { WatchPage } from "./watch";

/** Replays a recording on the watch page. The live tool's alarms and STOP stay in the header. */
export class ReplayPage implements Page {
  readonly keys;
  private readonly model = new Model(true);
  private readonly watch: WatchPage;
  private readonly bar: ReplayBar;
  private readonly connection: Connection;

  /** `scheduleRender` asks for a repaint. */
  constructor(box: HTMLElement, name: string, person: Person, scheduleRender: () => void) {
    this.watch = new WatchPage(box, this.model, person);
    this.connection = new Connection(`/api/recordings/${encodeURIComponent(name)}/replay`, {
      onConnected: (connected) => void (this.model.connected = connected),
      onMessage: (message, arrivedMs) => {
        this.model.onMessage(message, arrivedMs);
        scheduleRender();
        if (message.type === "hello") this.bar.showNotice("");
        if (message.type === "event") this.bar.showNotice(message.text);
      },
      onFrame: (frame, arrivedMs) => {
        this.model.onFrame(frame, arrivedMs);
        scheduleRender();
        if (frame.history) this.watch.charts.historyChanged();
      },
    });
    this.bar = new ReplayBar(this.watch.root, this.model, name, (control) => this.connection.send(control));
    this.keys = [...this.watch.keys, ...this.bar.keys];
    if (name.endsWith(".mcap")) {
      this.model.graspsOfRun = name.slice(0, -".mcap".length);
      void this.loadAnnotations(this.model.graspsOfRun);
    }
    this.connection.start();
  }

  /** Loads what people have said of the run. A recording that the index does not know has nothing. */
  private async loadAnnotations(run: string): Promise<void> {
    for (const truth of await getTruths(run).catch(() => [])) this.model.onTruth(truth);
    for (const mark of await getMarks(run).catch(() => [])) this.model.onMark(mark);
  }

  render(nowMs: number): void {
    this.watch.render(nowMs);
    this.bar.render();
  }

  themeChanged(): void {
    this.watch.themeChanged();
  }

  close(): void {
    this.connection.close();
    this.watch.close();
  }
}
