// A worker, since browsers throttle the timers of hidden pages but not a worker's. It sends the heartbeat while the page
// answers, and STOP.

const BEAT_MS = 100;
const PAGE_MS = 300; // without an answer for this time the page counts as hung
const RETRY_MS = 500;

let socket = null;
let setup = null;
let answered = 0;
let wanted = false; // a STOP that has not been sent yet

function open() {
  socket = new WebSocket(setup.url, setup.protocols);
  socket.addEventListener("open", () => {
    if (wanted) stop();
  });
  socket.addEventListener("message", () => postMessage({ stopped: true }));
  socket.addEventListener("close", () => setTimeout(open, RETRY_MS));
}

function stop() {
  wanted = socket.readyState !== WebSocket.OPEN;
  if (!wanted) socket.send('{"stop":true}');
}

onmessage = ({ data }) => {
  if (data.url) {
    setup = data;
    answered = performance.now();
    open();
    setInterval(() => {
      postMessage({ alive: true });
      if (socket.readyState === WebSocket.OPEN && performance.now() - answered < PAGE_MS) socket.send('{"beat":true}');
    }, BEAT_MS);
  } else if (data.stop) stop();
  else if (data.alive) answered = performance.now();
};
