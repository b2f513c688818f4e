/* Unpacks the player of the run; without it the page keeps its still views. */
(async () => {
  const packed = Uint8Array.from(atob(document.getElementById('player-code').textContent), c => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
  const script = document.createElement('script');
  script.textContent = await new Response(stream).text();
  document.head.append(script);
})();
