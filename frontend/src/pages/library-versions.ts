import { create } from "../dom";
import { getJson, postJson } from "../live/rest";
import type { Person } from "../shell/person";
import type { ApprovalRequest, LibraryApproval, LibraryVersion, RestoreRequest } from "../wire";

const MIN_REASON_LETTERS = 3;

/** Says what was decided on the text of a library. */
export function approvalInWords(approval: LibraryApproval | null | undefined): string {
  if (!approval) return "Not approved: for simulated tools only";
  const who = approval.by === null ? "" : ` by ${approval.by}`;
  const when = new Date(approval.at).toLocaleDateString("en-GB");
  return `${approval.approved ? "Approved for real tools" : "Approval withdrawn"}${who}, ${when}: ${approval.reason}`;
}

/** The texts of an own library: an admin approves one for real tools, an operator restores an earlier one. */
export class LibraryVersions {
  readonly box = create("ul", "file-versions");

  /** `attempt` shows a failure; `onChanged` is called after a change. */
  constructor(
    private readonly path: string,
    private readonly person: Person,
    private readonly attempt: (failure: string, act: () => Promise<void>) => Promise<void>,
    private readonly onChanged: () => void,
  ) {
    this.box.hidden = true;
  }

  async toggle(): Promise<void> {
    this.box.hidden = !this.box.hidden;
    if (!this.box.hidden) await this.attempt("No versions", () => this.load());
  }

  private async load(): Promise<void> {
    const versions = await getJson<LibraryVersion[]>(`${this.path}/versions`);
    const present = versions.find(({ current }) => current)?.version ?? null;
    this.box.replaceChildren(...versions.map((each) => this.line(each, present)));
  }

  private line(each: LibraryVersion, present: string | null): HTMLLIElement {
    const line = create("li");
    const saved = new Date(each.saved_at).toLocaleString("en-GB");
    line.append(create("span", "", `${each.current ? "Now" : "Earlier"}: ${each.version}, saved ${saved}. ${approvalInWords(each.approval)}`));
    if (this.person.may("admin")) line.append(this.decision(each));
    if (!each.current && this.person.may("operator")) {
      line.append(this.button("Restore", () => this.restore(each.version, present)));
    }
    return line;
  }

  /** A field for the reason, and the button that decides. */
  private decision({ version, approval }: LibraryVersion): HTMLElement {
    const approved = approval?.approved === true;
    const [form, reason] = [create("form", "truth-line"), create("input")];
    [reason.maxLength, reason.placeholder, reason.ariaLabel] = [300, "Why", `Reason for the decision on ${version}`];
    const decide = create("button", "action", approved ? "Withdraw" : "Approve");
    form.append(reason, decide);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.attempt("Not decided", async () => {
        if (reason.value.trim().length < MIN_REASON_LETTERS) throw new Error("say why, in a few words");
        const request: ApprovalRequest = { version, reason: reason.value.trim(), approved: !approved, by: this.person.name };
        await postJson(`${this.path}/approval`, request);
        await this.load();
        this.onChanged();
      });
    });
    return form;
  }

  private async restore(version: string, replaces: string | null): Promise<void> {
    await this.attempt("Not restored", async () => {
      const request: RestoreRequest = { version, replaces, by: this.person.name };
      await postJson(`${this.path}/restore`, request);
      await this.load();
      this.onChanged();
    });
  }

  private button(title: string, act: () => Promise<void>): HTMLButtonElement {
    const button = create("button", "action", title);
    button.type = "button";
    button.addEventListener("click", () => void act());
    return button;
  }
}
