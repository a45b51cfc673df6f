// The explorer as a widget of notebooks, an anywidget.

const contents = (model) => ({ header: model.get("header"), bytes: model.get("data") });

function render({ model, el }) {
  const askPaths = model.get("traces") ? (pixel, range) => model.send({ pixel, range }) : null;
  const explorer = mount(el, contents(model), { askPaths });
  const update = () => explorer.setData(contents(model));
  model.on("change:header", update);
  model.on("msg:custom", explorer.addPaths);
  return () => {
    model.off("change:header", update);
    model.off("msg:custom", explorer.addPaths);
    explorer.destroy();
  };
}

export default { render };
