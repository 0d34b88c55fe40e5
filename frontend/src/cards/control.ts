import { find, setHidden, setText } from "../dom";
import { giveControlBack, messageOf, takeControl } from "../live/rest";
import type { State } from "../wire";
import type { Person } from "../shell/person";

/** Who has control of the tool, where people are known by tokens; taking it over, giving it back. */
export class ControlLine {
  constructor(
    private readonly root: HTMLElement,
    private readonly person: Person,
    private readonly told: (failure: string) => void,
  ) {
    find(root, "control-take").addEventListener("click", () => this.ask(takeControl(), "Control was not taken over"));
    find(root, "control-give").addEventListener("click", () => this.ask(giveControlBack(), "Control was not given back"));
  }

  render(state: State | null): void {
    const holder = state?.demo ? null : (state?.control ?? null);
    setHidden(find(this.root, "control"), !this.person.isSignedIn || holder === null);
    const mine = holder === this.person.name;
    setText(find(this.root, "control-text"), mine ? "You have control." : `${holder} has control.`);
    setHidden(find(this.root, "control-take"), mine);
    setHidden(find(this.root, "control-give"), !mine || state?.run !== null);
  }

  private ask(asked: Promise<unknown>, failure: string): void {
    asked.catch((error: unknown) => this.told(`${failure}: ${messageOf(error)}`));
  }
}
