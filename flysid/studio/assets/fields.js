// Fields of a log in text boxes: dropped there, completed while typing.
import { el } from "./page.js";
import { shown } from "./plots.js";

// A text box that takes a field that is dragged here.
export function takesField(box, taken) {
  box.addEventListener("dragover", (event) => { if (event.dataTransfer.types.includes("text/x-field")) { event.preventDefault(); } });
  box.addEventListener("drop", (event) => {
    const name = event.dataTransfer.getData("text/x-field");
    if (!name) { return; }
    event.preventDefault();
    if (name.startsWith("@")) { box.placeholder = "a recipe's signal: choose that recipe, or drag a stream's field"; return; }
    box.value = shown(name);
    taken();
  });
}

// The streams and fields of a flight, for boxes that complete them: "known-streams", "known-fields".
export function knownFields(flight) {
  const options = (id, words) => el("datalist", { id }, words.map((value) => el("option", { value })));
  const fields = flight.streams.flatMap((group) => group.fields.map(([name]) => group.stream + "." + name));
  return [options("known-streams", flight.streams.map((group) => group.stream)), options("known-fields", fields.slice(0, 3000))];
}
