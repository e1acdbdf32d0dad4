// A scan that is going on: rows as they come, how it goes, and what to do about it.

/** Follows the scan of the server. */
export class Live {
  constructor(card, page) {
    this.card = card;
    this.page = page;
  }

  draw() {}
}
