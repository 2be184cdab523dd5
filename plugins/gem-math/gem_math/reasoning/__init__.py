"""``rg:*``: the tasks of ReasoningGym, whose library runs in processes of its own."""
