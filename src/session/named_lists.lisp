;;; anmech: lists whose entries also have names.
;;;
;;; A result that has always been a list of several things, taken apart by [M, D, K] : .. or by its places, stays one,
;;; and is read by names too: result@M.  The names are in the header of the list, where Maxima keeps its marks; so
;;; whatever makes a new list of it makes a plain one.  In two dimensions such a list is shown with its names; in one
;;; dimension, and in files, it is the plain list that can be typed back.
;;;
;;; Entry points: $anmech_named_list.

(in-package :anmech)
(needs "session/rows" "session/scope" "session/texts")

(defun names-of-list (form)
  "(head name ...) of a list with names, or nil."
  (and (operator-p form 'maxima::mlist)
       (let ((mark (find-if #'consp (cdar form)))) (and (eq (first mark) 'names) (rest mark)))))

(maxima::defmfun maxima::$anmech_named_list (head equations)
  "anmech_named_list('head, [name = entry, ...]): the list of the entries, which have these names."
  (cons `(maxima::mlist maxima::simp (names ,head ,@(mapcar #'second (rest equations))))
        (mapcar #'third (rest equations))))

(defun named-entry (form name)
  (destructuring-bind (head . names) (names-of-list form)
    (let ((place (position name names)))
      (if (and place (< place (length (rest form))))
          (nth place (rest form))
          (let ((*verb* (or *verb* head)))
            (complain "no field ~a; the fields are ~a" (one-line name) (english-list names)))))))

(let ((fields-of-others #'maxima::$@-function))
  (setf (symbol-function 'maxima::$@-function)
        (lambda (object field)
          (if (names-of-list object) (named-entry object field) (funcall fields-of-others object field)))))

;;; Display

(defun with-names-shown (form)
  "A call for display, without what is empty."
  (destructuring-bind (head . names) (names-of-list form)
    (cons (list head)
          (loop for name in names
                for entry in (rest form)
                unless (and (consp entry) (null (rest entry)))
                  collect `((maxima::mequal) ,name ,entry)))))

(show-lists maxima::dimension names-of-list (form result) (dimension-call (with-names-shown form) result))
(show-lists maxima::tex names-of-list (form left right)
  (maxima::tex-function (with-names-shown form) left right nil))
(show-lists maxima::wxxml names-of-list (form left right)
  (wxxml-call (with-names-shown form) left right))
