import { byId, setText } from "../dom";
import type { Role } from "../wire";
import type { Session } from "./session";
import { readStored, store } from "./storage";

const KEY = "graspwatch-person";

/** The person at this page: who is signed in, or else a name that this browser keeps. Requests carry the name. */
export class Person {
  private readonly dialog = byId("person-dialog", HTMLDialogElement);
  private readonly field = byId("person-name", HTMLInputElement);
  private onNamed: ((name: string) => void) | null = null;

  constructor(private readonly session: Session) {
    byId("person").addEventListener("click", () => (session.needed ? session.open() : this.open(null)));
    byId("person-cancel").addEventListener("click", () => this.close());
    byId("person-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.saveName(this.field.value.trim());
    });
    this.show();
  }

  get name(): string | null {
    return this.session.needed ? this.session.name : readStored(KEY);
  }

  /** Whether people sign in here, so that one of them has control of the tool. */
  get isSignedIn(): boolean {
    return this.session.needed && this.session.name !== null;
  }

  may(role: Role): boolean {
    return this.session.may(role);
  }

  /** Calls `then` with the name. Asks for it first if there is none yet. */
  withName(then: (name: string) => void): void {
    if (this.name) then(this.name);
    else this.open(then);
  }

  close(): void {
    this.onNamed = null;
    this.dialog.close();
    this.session.close();
  }

  private open(then: ((name: string) => void) | null): void {
    this.onNamed = then;
    this.field.value = this.name ?? "";
    if (!this.dialog.open) this.dialog.show(); // not modal: STOP must stay within reach
    this.field.select();
  }

  private saveName(name: string): void {
    if (name === "") return;
    store(KEY, name);
    const then = this.onNamed;
    this.close();
    this.show();
    then?.(name);
  }

  show(): void {
    const { needed, name, role } = this.session;
    if (needed) setText(byId("person"), name ? `${name} · ${role}` : "Sign in");
    else setText(byId("person"), this.name ? `You: ${this.name}` : "Who are you?");
  }
}
