// The WebSocket to the service: it is opened again by itself, whatever happens to it.

const FIRST_WAIT_MS = 200;
const LONGEST_WAIT_MS = 1000;
// A connection on which a live service says nothing for so long may be dead without a word: try another one.
const SILENCE_MS = 5000;

export class ServiceSocket {
  // handlers: info(message), frame(message), past(message), connected(isConnected)
  constructor(handlers) {
    this.handlers = handlers;
    this.waitMs = FIRST_WAIT_MS;
    this.socket = null;
    this.isLive = false;
    this.heardMs = performance.now();
    setInterval(() => this.watch(), 1000);
    this.open();
  }

  get isOpen() {
    return this.socket !== null && this.socket.readyState === WebSocket.OPEN;
  }

  send(message) {
    if (this.isOpen) this.socket.send(JSON.stringify(message));
    return this.isOpen;
  }

  open() {
    const address = new URL("socket", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    this.socket = socket;
    this.heardMs = performance.now();
    socket.onopen = () => this.handlers.connected(true);
    socket.onmessage = (event) => this.receive(JSON.parse(event.data));
    socket.onclose = () => this.lose(socket);
  }

  receive(message) {
    this.waitMs = FIRST_WAIT_MS;
    this.heardMs = performance.now();
    if (message.kind === "info") {
      this.isLive = message.is_live;
      this.handlers.info(message);
    } else if (message.kind === "frame") {
      this.handlers.frame(message);
    } else if (message.kind === "past") {
      this.handlers.past(message);
    }
  }

  lose(socket) {
    if (socket !== this.socket) return;
    this.socket = null;
    this.handlers.connected(false);
    setTimeout(() => this.open(), this.waitMs);
    this.waitMs = Math.min(LONGEST_WAIT_MS, 2 * this.waitMs);
  }

  watch() {
    if (this.socket === null || performance.now() - this.heardMs < SILENCE_MS) return;
    if (!this.isLive && this.isOpen) return;
    const socket = this.socket;
    this.lose(socket);
    socket.close();
  }
}
