"""How processes end: what signals ask for, children that end with their parent, temporary folders that go away whatever
happens. Needs nothing but Python.
"""
