// The search takes each word for the beginning of a word: "in" would find "info" and "index".
// Words that name nothing are left out of what is searched, unless nothing else was typed.
"use strict";
{
  const QUERY = 2; // the message that holds what was typed
  const empty = new Set(
    "a an and are as at be by can do does for from how i in into is it my not of on or that the this to use what when where which with".split(" "),
  );
  const send = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (message, ...rest) {
    if (message && message.type === QUERY && typeof message.data === "string") {
      const words = message.data.split(/\s+/).filter((word) => !empty.has(word.toLowerCase()));
      if (words.join("")) message = { ...message, data: words.join(" ") };
    }
    return send.call(this, message, ...rest);
  };
}
