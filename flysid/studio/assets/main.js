// The shell: which page the address names, and what all pages share.
import { get } from "./api.js";
import { Stay, address, complain } from "./page.js";

const PAGES = { // each is fetched when it is first shown
  flights: async () => (await import("./flights.js")).showFlights,
  channels: async () => (await import("./channels.js")).showChannels,
  runs: async () => (await import("./runs.js")).showRuns,
  jobs: async () => (await import("./jobs.js")).showJobs,
  live: async () => (await import("./live.js")).showLive,
};
let stay = new Stay();

async function turn() { // a page that was left while it loads ends in an element that nobody sees
  const { page, query } = address(), own = new Stay();
  stay.end();
  stay = own;
  try {
    const show = await (PAGES[page] || PAGES.flights)();
    if (!own.isOver) { await enter(page, show, query, own); }
  } catch (error) { if (!own.isOver) { complain(error); } }
}

async function enter(page, show, query, own) {
  complain(null);
  document.querySelectorAll("nav a").forEach((link) => {
    if (link.dataset.page === page) { link.setAttribute("aria-current", "page"); } else { link.removeAttribute("aria-current"); }
  });
  document.title = page[0].toUpperCase() + page.slice(1) + " \u2013 flysid studio";
  const before = document.getElementById("main"), main = before.cloneNode(false);
  delete main.dataset.ready;
  before.replaceWith(main);
  await show(main, query, own);
  main.dataset.ready = page;
}

window.addEventListener("hashchange", turn);
get("about").then((about) => {
  document.getElementById("place").textContent = about.data + " \u00b7 flysid " + about.version;
  document.querySelector("nav a[data-page=live]").hidden = !about.live;
}, complain);
turn();
