// The shell: which page the address names, and what all pages share.
import { get } from "./api.js";
import { address, complain, guarded } from "./page.js";

const PAGES = { // each is fetched when it is first shown
  flights: async () => (await import("./flights.js")).showFlights,
  channels: async () => (await import("./channels.js")).showChannels,
  runs: async () => (await import("./runs.js")).showRuns,
  jobs: async () => (await import("./jobs.js")).showJobs,
  live: async () => (await import("./live.js")).showLive,
};
const main = document.getElementById("main");
let leave = null, turns = 0;

const turn = guarded(async () => {
  const { page, query } = address(), number = ++turns;
  const show = await (PAGES[page] || PAGES.flights)();
  if (number !== turns) { return; } // another page was asked for since
  complain(null);
  if (leave) { leave(); leave = null; }
  document.querySelectorAll("nav a").forEach((link) => {
    if (link.dataset.page === page) { link.setAttribute("aria-current", "page"); } else { link.removeAttribute("aria-current"); }
  });
  document.title = page[0].toUpperCase() + page.slice(1) + " \u2013 flysid studio";
  delete main.dataset.ready;
  main.textContent = "";
  leave = (await show(main, query)) || null;
  main.dataset.ready = page;
});

window.addEventListener("hashchange", turn);
get("about").then((about) => {
  document.getElementById("place").textContent = about.data + " \u00b7 flysid " + about.version;
  document.querySelector("nav a[data-page=live]").hidden = !about.live;
}, complain);
turn();
