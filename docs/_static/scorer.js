// Ranks of the search: pages for developers come last, guides first.
var Scorer = {
  score: ([page, , , , points]) => {
    if (/^(decisions|about\/(decisions|promises|changes)|benchmarks)/.test(page)) return points / 10;
    if (/^(start|how-to|tutorial|trust|learn)/.test(page)) return points * 2;
    return points;
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
