// Folds: what a link points to is opened; paper shows those that are open.
"use strict";
(function () {
  function reveal() {
    const target = window.location.hash.length > 1 && document.getElementById(window.location.hash.slice(1));
    if (!target) return;
    const fold = target.querySelector("details");
    if (fold) fold.open = true;
    target.scrollIntoView();
  }
  window.addEventListener("hashchange", reveal);
  // a second click on the same link changes no hash
  document.querySelectorAll("nav a").forEach((a) => a.addEventListener("click", () => setTimeout(reveal, 0)));
  const every = document.getElementById("every-fold");
  every.addEventListener("click", () => {
    const open = every.getAttribute("aria-pressed") !== "true";
    document.querySelectorAll("details").forEach((d) => { d.open = open; });
    every.setAttribute("aria-pressed", String(open));
    every.textContent = open ? "close all" : "open all";
  });
  reveal();
})();
