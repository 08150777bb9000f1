"""Live page: campaigns in a browser during and after their runs. It only reads databases."""
