export async function explain() { return document.createDocumentFragment(); }
