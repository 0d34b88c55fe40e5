import { drawWaveform } from "../cards/waveform";
import { create, fill, find, setData, setHidden, setText } from "../dom";
import { deletePath, getJson, messageOf, postJson, useToolFile } from "../live/rest";
import { showHints } from "../shell/hints";
import { keepListsInThePage } from "../shell/keys";
import type { Person } from "../shell/person";
import type { Page } from "../shell/router";
import type { FileCheck, FileContent, FileKind, FileList, FileRequest, NamedFile } from "../wire";
import "../styles/pages.css";
import { confirmFirst, createQuestion } from "./confirm";
import { approvalInWords, LibraryVersions } from "./library-versions";
import { Polled } from "./polled";
import { headCell, Rows } from "./rows";
import { TEMPLATES } from "./protocol-templates";
import { ToolDraftForm } from "./tool-draft";
import markup from "./own-files.html?raw";

const PATH = "/api/configuration";
const EVERY_MS = 10_000;
const DIGITS = 4;
const KIND: Record<FileKind, string> = { protocol: "Protocol", library: "Tissue library", tool: "Tool file" };

/** A text in the editor, as it was opened or saved. `version` is that of the own file `name`; null: a new file. */
interface Opened {
  kind: FileKind;
  name: string;
  text: string;
  version: string | null;
}

/** Unsaved text of an editor that was left, for the next one. */
let leftDraft: { opened: Opened; kind: FileKind; text: string } | null = null;

/** Lists the files that are chosen by name, and edits own ones with a preview. */
export class OwnFilesPage implements Page {
  private readonly root: HTMLElement;
  private readonly kind: HTMLSelectElement;
  private readonly text: HTMLTextAreaElement;
  private readonly polled: Polled<FileList>;
  private readonly rows: Rows<NamedFile>;
  private opened: Opened = { kind: "protocol", name: "New protocol", text: TEMPLATES.steps, version: null };
  private readonly discardQuestion = createQuestion("Discard the unsaved text?", "Discard", () => this.openOther());
  /** Opens another text; called once the unsaved one may be discarded. */
  private openOther = (): void => {};

  constructor(
    box: HTMLElement,
    private readonly person: Person,
  ) {
    this.root = fill(box, markup);
    showHints(this.root);
    keepListsInThePage(this.root);
    this.kind = find(this.root, "file-kind", HTMLSelectElement);
    this.text = find(this.root, "file-text", HTMLTextAreaElement);
    for (const button of this.root.querySelectorAll<HTMLButtonElement>("button[data-template]")) {
      const text = TEMPLATES[button.dataset.template as keyof typeof TEMPLATES];
      button.addEventListener("click", () => this.replaceText({ kind: "protocol", name: "New protocol", text, version: null }));
    }
    this.text.addEventListener("dragover", (event) => event.preventDefault());
    this.text.addEventListener("drop", (event) => void this.drop(event));
    find(this.root, "file-check").addEventListener("click", () => void this.check());
    find(this.root, "file-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.save();
    });
    find(this.root, "file-message").before(this.discardQuestion.box);
    new ToolDraftForm(this.root, (name, text) => this.replaceText({ kind: "tool", name, text, version: null })).listen();
    this.begin(leftDraft?.opened ?? this.opened);
    if (leftDraft) [this.kind.value, this.text.value] = [leftDraft.kind, leftDraft.text];
    this.rows = new Rows(find(this.root, "own-files-body"), (file) => JSON.stringify(file), (file) => ({ element: this.row(file) }));
    const section = find(this.root, "own-files");
    this.polled = new Polled({ path: PATH, title: "The list", section, onAnswer: (list) => this.show(list) });
  }

  render(): void {}

  close(): void {
    leftDraft = this.isUnsaved ? { opened: this.opened, kind: this.kind.value as FileKind, text: this.text.value } : null;
    this.polled.close();
  }

  private show(list: FileList): number {
    setText(find(this.root, "own-files-folder"), list.folder);
    this.rows.show(list.files);
    return EVERY_MS;
  }

  private row(file: NamedFile): HTMLTableRowElement {
    const row = create("tr");
    row.dataset.name = file.name;
    const name = headCell("what");
    name.append(file.name, create("small", "", file.title ?? ""));
    for (const problem of file.problems) name.append(create("small", "problem", `✕ ${problem}`));
    const kind = create("td", "", KIND[file.kind]);
    kind.append(create("small", "", file.shipped ? "shipped" : "yours"));
    if (file.in_use) kind.append(create("small", "", file.in_use));
    const actions = create("td", "actions");
    const box = create("div");
    const open = create("button", "action", file.shipped ? "Open" : "Edit");
    open.type = "button";
    open.addEventListener("click", () => void this.open(file));
    box.append(open);
    actions.append(box);
    if (file.kind === "library" && !file.shipped) name.append(create("small", "", approvalInWords(file.approval)), this.versions(file, box));
    if (file.kind === "tool" && !file.problems.length) name.append(this.confirmed(box, "Use", "needs-admin", `Use ${file.name} now? The tool is disarmed.`, () => void this.use(file)));
    if (!file.shipped) name.append(this.confirmed(box, "Delete", file.kind === "tool" ? "needs-admin" : "needs-operator", `Delete ${file.name}?`, () => void this.remove(file)));
    row.append(name, kind, actions);
    return row;
  }

  /** Adds a button that shows the texts of a library. Returns their list. */
  private versions({ kind, name }: NamedFile, box: HTMLElement): HTMLElement {
    const path = `${PATH}/${kind}/${encodeURIComponent(name)}`;
    const versions = new LibraryVersions(path, this.person, (failure, act) => this.attempt(failure, act), () => this.polled.refresh());
    const button = create("button", "action", "Versions");
    button.type = "button";
    button.addEventListener("click", () => void versions.toggle());
    box.append(button);
    return versions.box;
  }

  /** Adds a button that asks before it acts. Returns its question. */
  private confirmed(box: HTMLElement, title: string, role: string, question: string, act: () => void): HTMLElement {
    const button = create("button", `action ${role}`, title);
    button.type = "button";
    box.append(button);
    return confirmFirst(button, question, title, act);
  }

  private get isUnsaved(): boolean {
    return this.text.value !== this.opened.text;
  }

  /** Opens another text, if necessary after a question about the unsaved one. */
  private replaceText(other: Opened, check?: FileCheck): void {
    this.openOther = () => this.begin(other, check);
    if (this.isUnsaved) this.discardQuestion.show(true);
    else this.openOther();
  }

  private begin(opened: Opened, check: FileCheck = { problems: [], name: null, protocol: null, library: null }): void {
    this.kind.value = opened.kind;
    this.text.value = opened.text;
    this.opened = { ...opened, text: this.text.value }; // the browser changes the ends of lines
    setText(find(this.root, "file-heading"), opened.name);
    this.showMessage("", "done");
    this.showCheck(check);
  }

  private async open({ kind, name }: NamedFile): Promise<void> {
    await this.attempt("Not opened", async () => {
      const content = await getJson<FileContent>(`${PATH}/${kind}/${encodeURIComponent(name)}`);
      const isCopy = content.file.shipped || (content.name !== null && content.name !== name); // it is saved under the name in it
      const version = isCopy ? null : content.version;
      this.replaceText({ kind, name: isCopy ? `Copy of ${name}` : name, text: content.text, version }, content);
    });
  }

  private async drop(event: DragEvent): Promise<void> {
    const file = event.dataTransfer?.files[0];
    if (!file) return; // dropped text goes into the field by itself
    event.preventDefault();
    this.replaceText({ kind: this.kind.value as FileKind, name: file.name, text: await file.text(), version: null });
  }

  private async check(): Promise<void> {
    await this.attempt("No preview", async () => this.showCheck(await postJson<FileCheck>(`${PATH}/${this.kind.value}/check`, { text: this.text.value })));
  }

  private async save(): Promise<void> {
    await this.attempt("Not saved", async () => {
      const [kind, text] = [this.kind.value as FileKind, this.text.value];
      const found = await postJson<FileCheck>(`${PATH}/${kind}/check`, { text });
      this.showCheck(found);
      if (found.problems.length) throw new Error("see below");
      const isSameFile = kind === this.opened.kind && found.name === this.opened.name; // another name is a new file
      const request: FileRequest = { text, replaces: isSameFile ? this.opened.version : null, by: this.person.name };
      const saved = await postJson<FileContent>(`${PATH}/${kind}`, request);
      this.opened = { kind, name: saved.file.name, text, version: saved.version };
      setText(find(this.root, "file-heading"), saved.file.name);
      this.showMessage(`Saved as ${saved.file.name}.`, "done");
    });
    this.polled.refresh();
  }

  private async remove({ kind, name }: NamedFile): Promise<void> {
    const by = this.person.name ? `?by=${encodeURIComponent(this.person.name)}` : "";
    await this.attempt("Not deleted", async () => {
      await deletePath(`${PATH}/${kind}/${encodeURIComponent(name)}${by}`);
      if (kind === this.opened.kind && name === this.opened.name) this.opened.version = null; // its text may be saved anew
      this.showMessage(`Deleted: ${name}.`, "done");
    });
    this.polled.refresh();
  }

  private async use({ name }: NamedFile): Promise<void> {
    await this.attempt("Not used", async () => {
      await useToolFile(name, this.person.name);
      this.showMessage(`${name} is used from now on. The tool is ready again in some seconds, disarmed. For the next start of the service, name it in its settings.`, "done");
    });
    this.polled.refresh();
  }

  private showCheck({ problems, protocol, library }: FileCheck): void {
    const list = find(this.root, "file-problems");
    setHidden(list, problems.length === 0);
    list.replaceChildren(...problems.map((problem) => create("li", "", problem)));
    setHidden(find(this.root, "file-preview"), protocol === null);
    if (protocol) drawWaveform(this.root, protocol);
    if (protocol?.refused) setText(find(this.root, "waveform-facts"), `This tool cannot play it: ${protocol.refused}`);
    setHidden(find(this.root, "file-tissues"), library === null);
    const rows = library?.tissues.map(({ title, alpha_n, beta_per_m, threshold_n }) => {
      const row = create("tr");
      const head = headCell("what");
      head.textContent = title;
      row.append(head, ...[alpha_n, beta_per_m, threshold_n].map((value) => create("td", "number", String(Number(value.toPrecision(DIGITS))))));
      return row;
    });
    find(this.root, "file-tissues-body").replaceChildren(...(rows ?? []));
  }

  private async attempt(failure: string, act: () => Promise<void>): Promise<void> {
    try {
      this.showMessage("", "done");
      await act();
    } catch (error) {
      this.showMessage(`${failure}: ${messageOf(error)}`, "failed");
    }
  }

  private showMessage(text: string, outcome: "done" | "failed"): void {
    const message = find(this.root, "file-message");
    setData(message, "outcome", outcome);
    setText(message, text);
  }
}
