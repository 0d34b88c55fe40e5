/** A clock that goes on while the tab is hidden, when the page's own timers are held back to one a minute. */
setInterval(() => postMessage(null), 100);
