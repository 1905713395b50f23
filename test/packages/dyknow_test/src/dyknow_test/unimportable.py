raise RuntimeError("this module needs a camera")
