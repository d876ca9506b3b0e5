"""A robot in the browser, joint by joint, beside another one, and as it moved in a log."""
