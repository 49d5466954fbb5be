// The order of what the search finds: pages of the guide, then the API, then the rest.
var Scorer = {
  score: ([docname, title, anchor, descr, score]) => {
    if (/^(genindex|py-modindex|search)/.test(docname)) return score - 100;
    if (/^(benchmarks|compare|theory\/claims)/.test(docname)) return score - 4;
    return score + (docname.includes("/") ? 0 : 10);
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
