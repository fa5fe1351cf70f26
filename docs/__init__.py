"""Pages of the documentation, and the code that draws their figures and builds their site."""
