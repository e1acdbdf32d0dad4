// What ESLint asks of the page. Names that are not defined are found by tsc.

import js from "@eslint/js";

export default [
  { ignores: ["docs/**", ".venv*/**"] },
  js.configs.recommended,
  {
    rules: {
      "no-undef": "off",
      "prefer-const": "error",
      "no-var": "error",
      eqeqeq: "error",
      "no-shadow": "error",
      "no-param-reassign": "off",
      "max-lines-per-function": ["error", { max: 60, skipComments: true }],
    },
  },
];
