"""What the tests share: the server's process, reference environments, ONNX policies."""
