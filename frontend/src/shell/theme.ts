import { byId, setText } from "../dom";
import { readStored, store } from "./storage";

const KEY = "graspwatch-theme";

/** The dark or light theme: the person's choice, else the system's preference, else dark. */
export class Theme {
  constructor(private readonly onChange: () => void) {
    const chosen = readStored(KEY);
    this.apply(chosen ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"));
    byId("theme").addEventListener("click", () => this.toggle());
  }

  toggle(): void {
    const next = document.documentElement.dataset.theme === "light" ? "dark" : "light";
    store(KEY, next);
    this.apply(next);
    this.onChange();
  }

  private apply(theme: string): void {
    document.documentElement.dataset.theme = theme;
    setText(byId("theme-text"), theme === "light" ? "Dark" : "Light");
  }
}
