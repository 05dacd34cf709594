;;; anmech: lists whose entries also have names.
;;;
;;; A result that has always been a list of several things, taken apart by [M, D, K] : .. or by its places, stays one,
;;; and is read by names too: result@M.  The names are in the header of the list, where Maxima keeps its marks; so
;;; whatever makes a new list of it makes a plain one.  In two dimensions such a list is shown with its names; in one
;;; dimension, and in files, it is the plain list that can be typed back.
;;;
;;; Entry points: $anmech_named_list.

(in-package :anmech)
(needs "session/scope" "session/texts")

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

(defmacro show-with-names (property function &rest arguments)
  "Lists with names are shown by FUNCTION, a function of a call and ARGUMENTS, others as they are."
  `(let ((plain (get 'maxima::mlist ',property)))
     (when plain
       (setf (get 'maxima::mlist ',property)
             (lambda (form ,@arguments)
               (if (names-of-list form)
                   (funcall ,function (with-names-shown form) ,@arguments)
                   (funcall plain form ,@arguments)))))))

(show-with-names maxima::dimension 'maxima::dimension-function result)
(show-with-names maxima::tex (lambda (form left right) (maxima::tex-function form left right nil)) left right)
(show-with-names maxima::wxxml (lambda (form left right) (funcall 'maxima::wxxml-function form left right)) left right)
