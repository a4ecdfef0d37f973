// The shell: which page the address names, and what all pages share.
import { get } from "./api.js";
import { address, complain, guarded } from "./page.js";
import { showFlights } from "./flights.js";
import { showChannels } from "./channels.js";
import { showRuns } from "./runs.js";
import { showJobs } from "./jobs.js";
import { showLive } from "./live.js";

const PAGES = { flights: showFlights, channels: showChannels, runs: showRuns, jobs: showJobs, live: showLive };
const main = document.getElementById("main");
let leave = null;

const turn = guarded(async () => {
  const { page, query } = address();
  const show = PAGES[page] || showFlights;
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
