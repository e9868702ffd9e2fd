// The element of the page that holds one view: curves, map, diagram or car.
export default {
  template: "<div></div>",
  props: { kind: String, spec: Object },
  mounted() { this.view = window.VSense.make(this.kind, this.$el, JSON.parse(JSON.stringify(this.spec))); },
  unmounted() { this.view.dispose(); },
  watch: { spec: { deep: true, handler(spec) { this.view.update(JSON.parse(JSON.stringify(spec))); } } },
};
