"""Data association: which of a state's landmarks each observation of a step is of.

``candidates`` measures every pair once; ``greedy``, ``assignment``, ``joint`` and ``known`` choose among them and
answer alike (``result``). Adding a method is one file and one row of ``methods``.
"""
