"""A rig in a browser: firmware and plant compiled to WebAssembly, and a page with the scope of the console."""
