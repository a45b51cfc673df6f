// The explorer as a component of Panel. The model has `header` and, set before it, `data`.

export function render({ model }) {
  const element = document.createElement("div");
  element.style.width = "100%";
  let explorer = null;
  const show = () => {
    if (!model.header.kind) return;
    const data = { header: model.header, bytes: new Uint8Array(model.data) };
    if (explorer) explorer.setData(data);
    else explorer = mount(element, data);
  };
  model.on("header", show);
  model.on("remove", () => explorer?.destroy());
  model.ready += 1;
  show();
  return element;
}
