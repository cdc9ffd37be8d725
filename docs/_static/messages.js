// Shows the rows of the tables of messages that fit what stands in the box.
"use strict";

/** How well a text fits a message: letters of the message that stand in it, in their order.
 * 0 if it does not fit.  An ellipsis of the message stands for any text. */
function fit(said, message) {
  let at = 0, letters = 0;
  for (const piece of message.split("\u2026").map((one) => one.trim()).filter(Boolean)) {
    const found = said.indexOf(piece, at);
    if (found < 0) return 0;
    at = found + piece.length;
    letters += piece.length;
  }
  return letters;
}

/** Which of the messages are shown for a text: those that it contains, else those with its words. */
function chosen(said, messages) {
  const plain = (text) => text.toLowerCase().replace(/\s+/g, " ").trim();
  said = plain(said);
  const fits = messages.map((one) => fit(said, plain(one)));
  const most = Math.max(...fits);
  if (said && most > 7) return fits.map((one) => 2 * one > most);
  return messages.map((one) => said.split(" ").every((word) => plain(one).includes(word)));
}

if (typeof document === "undefined") {
  module.exports = { chosen };
} else {
  const rows = [...document.querySelectorAll("article tbody tr")];
  const box = document.getElementById("message");
  const nothing = document.createElement("p");
  nothing.textContent = "No message fits: try fewer words of it, without names and numbers.";
  nothing.hidden = true;
  box.after(nothing);
  box.addEventListener("input", () => {
    const shown = chosen(box.value, rows.map((row) => row.cells[0].textContent));
    rows.forEach((row, index) => (row.hidden = !shown[index]));
    nothing.hidden = shown.includes(true);
  });
}
