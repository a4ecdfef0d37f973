// The live page by itself, where the studio is not installed.
import { guarded } from "./page.js";
import { showLive } from "./live.js";

const main = document.getElementById("main");
guarded(async () => {
  await showLive(main);
  main.dataset.ready = "live";
})();
