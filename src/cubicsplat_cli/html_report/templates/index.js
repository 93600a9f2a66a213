"use strict";
(() => {
  const body = document.querySelector("tbody"), headings = [...document.querySelectorAll("th")];
  headings.forEach((heading, column) => {
    const button = heading.querySelector("button");
    if (button) button.addEventListener("click", () => sort(heading, column));
  });
  function sort(heading, column) {
    // Names begin with the first, figures with the largest.
    const names = heading.classList.contains("name");
    const now = heading.getAttribute("aria-sort") || (names ? "descending" : "ascending");
    const up = now !== "ascending";
    for (const other of headings) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", up ? "ascending" : "descending");
    const value = (row) => row.cells[column].dataset.value;
    const order = (a, b) => (names ? value(a).localeCompare(value(b), undefined, { numeric: true }) : value(a) - value(b));
    // What has no figure is last either way.
    const missing = (row) => (value(row) === "" ? 1 : 0);
    const rows = [...body.rows].sort((a, b) => missing(a) - missing(b) || (up ? 1 : -1) * order(a, b));
    body.append(...rows);
  }
})();
