import { byId, create, setAttribute } from "../dom";
import type { KeyAction } from "./keys";

/** A page: the content below the header. */
export interface Page {
  /** Draws the page: at each repaint with new data, and ten times a second without. */
  render(nowMs: number): void;
  /** Keys of this page only. */
  readonly keys?: KeyAction[];
  /** Redraws what uses the theme's colors. */
  themeChanged?(): void;
  close(): void;
}

export interface Route {
  /** Name of its link in the navigation. */
  name: string;
  title: string;
  matches: (path: string) => boolean;
  /** Loads the page's code. The result builds the page. */
  load: () => Promise<(box: HTMLElement, path: string) => Page>;
}

/** Shows the page of the current address. Links within the service switch pages without a reload. */
export class Router {
  page: Page | null = null;
  private opening = 0;
  private readonly box = byId("page");

  constructor(
    private readonly routes: Route[],
    private readonly onOpen: () => void,
  ) {
    document.addEventListener("click", (event) => this.follow(event));
    window.addEventListener("popstate", () => void this.show());
  }

  go(path: string): void {
    if (path === location.pathname && this.page) return; // the open page keeps what the person has entered
    history.pushState(null, "", path);
    void this.show();
  }

  async show(): Promise<void> {
    const opening = ++this.opening;
    const path = location.pathname;
    const route = this.routes.find(({ matches }) => matches(path)) ?? this.routes[0];
    if (!route) return;
    this.page?.close();
    this.page = null;
    for (const link of document.querySelectorAll<HTMLElement>("nav [data-page]")) {
      if (link.dataset.page === route.name) setAttribute(link, "aria-current", "page");
      else link.removeAttribute("aria-current");
    }
    document.title = `${route.title} · Graspwatch`;
    this.box.replaceChildren();
    this.box.scrollTop = 0;
    scrollTo(0, 0);
    try {
      const build = await route.load();
      if (opening !== this.opening) return; // the person has opened another page meanwhile
      this.page = build(this.box, path);
      this.onOpen();
    } catch (error) {
      if (opening === this.opening) this.showFailure(error);
    }
  }

  /** Shows why a page could not be loaded, most likely a lost connection. The rest of the program goes on. */
  private showFailure(error: unknown): void {
    const box = create("section", "card");
    const reload = create("button", "", "Load this page again");
    reload.addEventListener("click", () => location.reload());
    const why = error instanceof Error ? error.message : String(error);
    box.append(create("h2", "", "This page cannot be shown"), create("p", "", why), reload);
    this.box.replaceChildren(box);
  }

  private follow(event: MouseEvent): void {
    const link = event.target instanceof Element ? event.target.closest("a") : null;
    const plain = event.button === 0 && !event.ctrlKey && !event.metaKey && !event.shiftKey && !event.altKey;
    if (!link || !plain || event.defaultPrevented || link.origin !== location.origin) return;
    const stays = !link.target && !link.hasAttribute("download") && !link.pathname.startsWith("/api/");
    if (!stays || link.pathname.startsWith("/docs")) return;
    event.preventDefault();
    this.go(link.pathname);
  }
}
