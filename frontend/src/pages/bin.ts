import { create, find, setHidden, setText } from "../dom";
import { bytes } from "../format";
import { deletePath, messageOf, postJson } from "../live/rest";
import type { Person } from "../shell/person";
import type { BinContent, BinnedRecording } from "../wire";
import { confirmFirst, onSinglePress } from "./confirm";
import { Polled } from "./polled";
import { dateTime, headCell, moment, Rows, type Row } from "./rows";

const EVERY_MS = 10_000;

/** Lists deleted recordings, with buttons to restore one and to remove all for good. */
export class BinSection {
  private readonly rows: Rows<BinnedRecording>;
  private readonly polled: Polled<BinContent>;

  /** `onChange` is called after every change. `onResult` gets the reason if one failure, else null. */
  constructor(
    private readonly root: HTMLElement,
    private readonly person: Person,
    private readonly onChange: () => void,
    private readonly onResult: (text: string | null) => void,
  ) {
    this.rows = new Rows(find(root, "bin-body"), ({ entry }) => entry, (recording) => this.makeRow(recording));
    const empty = find(root, "bin-empty", HTMLButtonElement);
    find(root, "bin-confirm").append(confirmFirst(empty, "Remove all of these for good?", "Remove for good", () => this.empty()));
    this.polled = new Polled({ path: "/api/bin", title: "The bin", section: find(root, "bin"), onAnswer: (content) => this.onAnswer(content) });
  }

  refresh(): void {
    this.polled.refresh();
  }

  close(): void {
    this.polled.close();
  }

  private onAnswer({ recordings, size_bytes: size, keep_days: days }: BinContent): number {
    const none = recordings.length === 0;
    this.rows.show(recordings);
    setText(find(this.root, "bin-note"), `What is deleted stays here for ${days} days, and takes room on the disk as long.`);
    setText(find(this.root, "bin-count"), none ? "Nothing is in the bin." : `${recordings.length} in the bin, ${bytes(size)}`);
    for (const id of ["bin-box", "bin-tools"]) setHidden(find(this.root, id), none);
    return EVERY_MS;
  }

  private makeRow(recording: BinnedRecording): Row<BinnedRecording> {
    const { entry, name, deleted_at: at, deleted_by: by, expires_at: until, size_bytes: size } = recording;
    const [element, what, when, actions] = [create("tr"), headCell("what"), create("td"), create("td", "actions")];
    when.append(moment(at, dateTime(at)), create("small", "", by === null ? "" : `by ${by}`));
    const expires = create("td", "roomy");
    expires.append(moment(until, dateTime(until)));
    const restore = create("button", "action needs-admin", "Restore");
    restore.type = "button";
    restore.dataset.testid = "bin-restore";
    restore.ariaLabel = `Restore ${name}`;
    onSinglePress(restore, () => {
      this.person.withName((who) => {
        const path = `/api/bin/${encodeURIComponent(entry)}/restore?by=${encodeURIComponent(who)}`;
        this.run(postJson(path), `${name} was not restored`);
      });
    });
    what.append(create("span", "", name));
    actions.append(restore);
    element.append(what, when, expires, create("td", "number roomy", bytes(size)), actions);
    return { element };
  }

  private empty(): void {
    this.person.withName((who) => {
      this.run(deletePath(`/api/bin?by=${encodeURIComponent(who)}`), "The bin was not emptied");
    });
  }

  private run(request: Promise<unknown>, failure: string): void {
    request.then(
      () => this.onResult(null),
      (error: unknown) => this.onResult(`${failure}: ${messageOf(error)}`),
    );
    void request.catch(() => undefined).then(() => (this.refresh(), this.onChange()));
  }
}
