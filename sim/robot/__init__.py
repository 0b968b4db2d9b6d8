"""The simulated Kawasaki RS007L with its controller, F/T sensor, tool and a compliant plate."""
