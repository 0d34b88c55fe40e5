import { Connection } from "../live/connection";
import { Model } from "../live/model";
import type { Person } from "../shell/person";
import type { Page } from "../shell/router";
import { ReplayBar } from "./replay-bar";
import { WatchPage } from "./watch";

/** A recording on the page of the live tool, with a clock of its own. The live tool's alarms and STOP stay above it. */
export class ReplayPage implements Page {
  readonly keys;
  private readonly model = new Model(true);
  private readonly watch: WatchPage;
  private readonly bar: ReplayBar;
  private readonly connection: Connection;

  /** `schedule` asks for a picture. */
  constructor(box: HTMLElement, name: string, person: Person, schedule: () => void) {
    this.watch = new WatchPage(box, this.model, person);
    this.connection = new Connection(`/api/recordings/${encodeURIComponent(name)}/replay`, {
      onConnected: (connected) => void (this.model.connected = connected),
      onMessage: (message, arrivedMs) => {
        this.model.take(message, arrivedMs);
        schedule();
        if (message.type === "hello") this.bar.tell("");
        if (message.type === "event") this.bar.tell(message.text);
      },
      onFrame: (frame, arrivedMs) => {
        this.model.takeFrame(frame, arrivedMs);
        schedule();
        if (frame.history) this.watch.charts.historyChanged();
      },
    });
    this.bar = new ReplayBar(this.watch.root, this.model, name, (wanted) => this.connection.send(wanted));
    this.keys = [...this.watch.keys, ...this.bar.keys];
    this.connection.start();
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
