/* Saves a figure as SVG or PNG: all drawings of the figure side by side, on white, in the colours of the light scheme. */
const NS = 'http://www.w3.org/2000/svg';
function drawing(figure) {
  const whole = document.createElementNS(NS, 'svg');
  let width = 0, height = 0;
  figure.querySelectorAll('svg[role=img]').forEach(svg => {
    const box = svg.viewBox.baseVal, part = svg.cloneNode(true), size = [box.width / 4, box.height / 4];
    part.setAttribute('x', width);
    part.setAttribute('width', size[0]);
    part.setAttribute('height', size[1]);
    width += size[0];
    height = Math.max(height, size[1]);
    whole.append(part);
  });
  const back = document.createElementNS(NS, 'rect'), size = { width: width, height: height };
  Object.entries(size).forEach(([key, value]) => {
    whole.setAttribute(key, value);
    back.setAttribute(key, value);
  });
  back.setAttribute('fill', 'white');
  whole.prepend(back);
  whole.setAttribute('font-family', 'system-ui, sans-serif');
  const text = new XMLSerializer().serializeToString(whole);
  return { width, height, blob: new Blob([text], { type: 'image/svg+xml' }) };
}
function save(blob, name) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
function savePng({ width, height, blob }, name) {
  const image = new Image(), url = URL.createObjectURL(blob);
  image.onload = () => {
    const canvas = document.createElement('canvas');
    canvas.width = 2 * width;
    canvas.height = 2 * height;
    canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
    URL.revokeObjectURL(url);
    canvas.toBlob(png => save(png, name));
  };
  image.src = url;
}
document.querySelectorAll('.save').forEach(buttons => {
  buttons.hidden = false;
  buttons.addEventListener('click', event => {
    const format = event.target.dataset.save;
    if (!format) return;
    const figure = buttons.closest('figure'), name = `${figure.id}.${format}`, drawn = drawing(figure);
    format === 'png' ? savePng(drawn, name) : save(drawn.blob, name);
  });
});
