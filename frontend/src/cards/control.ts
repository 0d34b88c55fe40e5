import { find, setHidden, setText } from "../dom";
import { giveControlBack, messageOf, takeControl } from "../live/rest";
import type { State } from "../wire";
import type { Person } from "../shell/person";

/** Shows who has control of the tool, where people sign in, with buttons to take it over and to give it back. */
export class ControlLine {
  constructor(
    private readonly root: HTMLElement,
    private readonly person: Person,
    private readonly onFailure: (failure: string) => void,
  ) {
    find(root, "control-take").addEventListener("click", () => this.send(takeControl(), "Control was not taken over"));
    find(root, "control-give").addEventListener("click", () => this.send(giveControlBack(), "Control was not given back"));
  }

  render(state: State | null): void {
    const holder = state?.demo ? null : (state?.control ?? null);
    setHidden(find(this.root, "control"), !this.person.isSignedIn || holder === null);
    const isHolder = holder === this.person.name;
    setText(find(this.root, "control-text"), isHolder ? "You have control." : `${holder} has control.`);
    setHidden(find(this.root, "control-take"), isHolder);
    setHidden(find(this.root, "control-give"), !isHolder || state?.run !== null);
  }

  private send(request: Promise<unknown>, failure: string): void {
    request.catch((error: unknown) => this.onFailure(`${failure}: ${messageOf(error)}`));
  }
}
