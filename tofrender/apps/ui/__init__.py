"""Components, style and page of all applications in browsers."""
