"use strict";
(() => {
{% include "basics.js" %}
{% include "cell.js" %}
{% include "map.js" %}
{% include "live.js" %}
})();
