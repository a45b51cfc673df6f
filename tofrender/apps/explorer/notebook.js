// The explorer as a widget of notebooks, an anywidget.

const contents = (model) => ({ header: model.get("header"), bytes: model.get("data") });

function render({ model, el }) {
  const explorer = mount(el, contents(model));
  const update = () => explorer.setData(contents(model));
  model.on("change:header", update);
  return () => {
    model.off("change:header", update);
    explorer.destroy();
  };
}

export default { render };
