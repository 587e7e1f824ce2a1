"""Answers each image that it is sent with 100 kB."""

import http.server


class Detector(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    # One write of the head, one of the body: the kernel is not to wait for more in between.
    wbufsize = -1

    def do_POST(self):
        self.rfile.read(int(self.headers["Content-Length"]))
        found = b"x" * (100_000 if self.path.startswith("/detect") else 10)
        self.send_response(200)
        self.send_header("Content-Length", str(len(found)))
        self.end_headers()
        self.wfile.write(found)

    def log_message(self, *_):
        pass


http.server.ThreadingHTTPServer(("0.0.0.0", 8080), Detector).serve_forever()
