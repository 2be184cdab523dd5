"""Problems with figures: observations that hold images, and figures drawn by code."""
