// The live page by itself, where the studio is not installed.
import { Stay, address, guarded } from "./page.js";
import { showLive } from "./live.js";

const main = document.getElementById("main");
guarded(async () => {
  await showLive(main, address().query, new Stay());
  main.dataset.ready = "live";
})();
