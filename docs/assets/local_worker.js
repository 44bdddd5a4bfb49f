/* Browsers start no worker from a file on disk. There the search runs in a hidden frame instead, which answers as a worker. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.appendChild(frame)
      const inside = frame.contentWindow
      const load = (...urls) => urls.reduce((before, src) => before.then(() => new Promise((done) => {
        const script = document.createElement("script")
        script.src = src
        script.onload = done
        document.body.appendChild(script)
      })), Promise.resolve())
      inside.document.open()
      inside.document.write(
        `<body><script>postMessage = (data) => parent.postMessage(data, "*"); importScripts = ${load}<\/script>` +
        `<script src="${url}"><\/script></body>`
      )
      inside.document.close()
      this.ready = new Promise((done) => { inside.onload = done }) // opening a document forgets who listens
      addEventListener("message", (event) => {
        if (event.source === inside) this.dispatchEvent(new MessageEvent("message", { data: event.data }))
      })
      this.inside = inside
    }
    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data: structuredClone(data) })))
    }
  }
}
