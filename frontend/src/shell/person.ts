import { byId, setText } from "../dom";

const KEY = "graspwatch-person";

/** Who sits at this page: asked once, kept in this browser, sent with what the person does. */
export class Person {
  private readonly dialog = byId<HTMLDialogElement>("person-dialog");
  private readonly field = byId<HTMLInputElement>("person-name");
  private waiting: ((name: string) => void) | null = null;

  constructor() {
    byId("person").addEventListener("click", () => this.open(null));
    byId("person-cancel").addEventListener("click", () => this.close());
    byId("person-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.take(this.field.value.trim());
    });
    this.show();
  }

  get name(): string | null {
    return localStorage.getItem(KEY);
  }

  /** Calls `then` with the name, asking for it first if there is none yet. */
  withName(then: (name: string) => void): void {
    if (this.name) then(this.name);
    else this.open(then);
  }

  close(): void {
    this.waiting = null;
    this.dialog.close();
  }

  private open(then: ((name: string) => void) | null): void {
    this.waiting = then;
    this.field.value = this.name ?? "";
    if (!this.dialog.open) this.dialog.show(); // not modal: STOP must stay within reach
    this.field.select();
  }

  private take(name: string): void {
    if (name === "") return;
    localStorage.setItem(KEY, name);
    const then = this.waiting;
    this.close();
    this.show();
    then?.(name);
  }

  private show(): void {
    setText(byId("person"), this.name ? `You: ${this.name}` : "Who are you?");
  }
}
